"""Any npy or npz by a key map: a YAML file that describes the arrays.

    fps: 25                          # or {key: fps}
    head_model: flame                # anny or flame: the head model of the expression
    head: {key: pose, columns: [0, 3], rotation_format: rotation_vector, unit: radians}
    gaze: {key: eyes, columns: [0, 6], rotation_format: rotation_vector, unit: radians, eyes: left_right, frame: head}
    jaw:  {key: pose, columns: [3, 6], rotation_format: rotation_vector}
    lid:  {key: eyelids, eyes: left_right}
    translation: {key: transl, scale: 0.001}
    expression: {key: exp}

An npy has one array, and no key. `rotation_format` is one of `rotations`. `axis_signs` maps the axes of vectors to this
project's (+x left, +y up, +z out of the face). `frame: space` is gaze in space, from which the head rotation is
removed. A single value for gaze or lids is used for both eyes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy import ndarray
from pydantic import ValidationError

from talkingeyes.core import rotation
from talkingeyes.core.containers import read_npy, read_npz, read_yaml, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import Settings
from talkingeyes.formats.readers.flame_parameters import EXPRESSION
from talkingeyes.formats.rotations import rotation_width, to_rotation_vectors


class ArrayMapping(Settings):
    """Location and meaning of a quantity in a file. The defaults are the conventions of this project."""

    key: str | None = None
    columns: tuple[int, int] | None = None
    rotation_format: str = "rotation_vector"
    unit: Literal["radians", "degrees"] = "radians"
    eyes: Literal["left_right", "right_left"] = "left_right"
    frame: Literal["head", "space"] = "head"
    axis_signs: tuple[float, float, float] = (1.0, 1.0, 1.0)
    scale: float = 1.0


class KeyMap(Settings):
    """The map of a kind of file."""

    fps: float | ArrayMapping | None = None
    head_model: Literal["anny", "flame"] = "flame"
    head: ArrayMapping | None = None
    gaze: ArrayMapping | None = None
    jaw: ArrayMapping | None = None
    lid: ArrayMapping | None = None
    translation: ArrayMapping | None = None
    expression: ArrayMapping | None = None


def load_key_map(path: Path) -> KeyMap:
    """Read a map. Raises InputError with the invalid key and value."""
    try:
        return KeyMap.model_validate(read_yaml(path, "map"))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {where}: {first['msg']}, got {first['input']!r}") from None


def read_with_map(path: Path, mapping: KeyMap, fps: float | None = None) -> Motion:
    """Read the motion of a file by its map."""
    parts = {name: getattr(mapping, name) for name in ("head", "gaze", "jaw", "lid", "translation", "expression")}
    content = _content(path, {each.key or name for name, each in mapping if isinstance(each, ArrayMapping)})
    if parts["head"] is None and parts["gaze"] is None:
        raise InputError(f"{path}: the map should contain head or gaze, got neither")
    rows = {name: _rows(path, content, name, field) for name, field in parts.items() if field is not None}
    lengths = {name: len(array) for name, array in rows.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"{path}: all arrays should have the same number of frames, got {lengths}")
    frames = next(iter(lengths.values()))
    head = _joint(rows["head"], parts["head"]) if "head" in rows else np.zeros((frames, 3))
    others: dict[str, Any] = {}
    if "jaw" in rows:
        others["jaw"] = _joint(rows["jaw"], parts["jaw"])
    if "lid" in rows:
        others["lid"] = _of_eyes(rows["lid"], parts["lid"], 1)[..., 0] * parts["lid"].scale
    if "translation" in rows:
        others["translation"] = (
            rows["translation"] * parts["translation"].scale * np.array(parts["translation"].axis_signs)
        )
    if "expression" in rows:
        others["expression"] = rows["expression"] * parts["expression"].scale
        others["expression_names"] = _names(path, mapping.head_model, rows["expression"].shape[1])
    gaze = _eyes(rows["gaze"], parts["gaze"], head) if "gaze" in rows else np.zeros((frames, 2, 3))
    return Motion.of(_rate(path, content, mapping, fps), head, gaze, head_model=mapping.head_model, **others)


def _names(path: Path, head_model: str, width: int) -> tuple[str, ...]:
    if head_model == "flame":
        return tuple(EXPRESSION.format(number) for number in range(width))
    from talkingeyes.formats.arkit import EXPRESSION as names

    if width != len(names):
        raise InputError(f"{path}: expression of anny should have {len(names)} columns, got {width}")
    return names


def _joint(rows: ndarray, field: ArrayMapping) -> ndarray:
    angles = field.rotation_format in ("rotation_vector", "yaw_pitch") or field.rotation_format.startswith("euler_")
    turned = to_rotation_vectors(
        np.radians(rows) if angles and field.unit == "degrees" else rows, field.rotation_format
    )
    # A rotation vector is an axial vector: a reflection of axes reverses the sense of rotation.
    return np.asarray(turned * np.array(field.axis_signs) * np.prod(field.axis_signs))


def _eyes(rows: ndarray, field: ArrayMapping, head: ndarray) -> ndarray:
    both = _of_eyes(rows, field, rotation_width(field.rotation_format))
    turned = np.stack([_joint(both[:, eye], field) for eye in range(2)], axis=1)
    return rotation.eye_in_head(head, rotation.gaze_to_angles(turned)) if field.frame == "space" else turned


def _of_eyes(rows: ndarray, field: ArrayMapping, width: int) -> ndarray:
    """(T, 2, width), the eyes in the order of this project."""
    if rows.shape[1] == width:
        return np.repeat(rows[:, None], 2, axis=1)
    if rows.shape[1] != 2 * width:
        raise InputError(f"{field.key or 'array'}: should have {width} or {2 * width} columns, got {rows.shape[1]}")
    both = rows.reshape(len(rows), 2, width)
    return np.asarray(both[:, ::-1] if field.eyes == "right_left" else both)


def _rows(path: Path, content: Mapping[str, ndarray], name: str, field: ArrayMapping) -> ndarray:
    key = field.key or ("" if "" in content else name)
    if key not in content:
        raise InputError(f"{path}: should hold {key or name}, got {', '.join(content) or 'one array'}")
    array = np.asarray(content[key])
    array = array[0] if array.ndim > 2 and len(array) == 1 else array
    if array.ndim < 2 or array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {key or name} should be numbers (T, ...), got {array.shape} {array.dtype}")
    rows = array.astype(np.float64).reshape(len(array), -1)
    if not np.isfinite(rows).all():
        raise InputError(f"{path}: {key or name} holds NaN or infinite values")
    if field.columns is not None:
        first, stop = field.columns
        if not 0 <= first < stop <= rows.shape[1]:
            raise InputError(f"{path}: columns of {name} should lie in 0 to {rows.shape[1]}, got {first} to {stop}")
        rows = rows[:, first:stop]
    width = {
        "head": rotation_width(field.rotation_format),
        "jaw": rotation_width(field.rotation_format),
        "translation": 3,
    }.get(name)
    if width is not None and rows.shape[1] != width:
        raise InputError(f"{path}: {name} should have {width} columns ({field.rotation_format}), got {rows.shape[1]}")
    return rows


def _rate(path: Path, content: Mapping[str, ndarray], mapping: KeyMap, fps: float | None) -> float:
    if fps is not None:
        return fps
    if isinstance(mapping.fps, ArrayMapping):
        key = mapping.fps.key or "fps"
        if key not in content:
            raise InputError(f"{path}: should hold {key}, got {', '.join(content)}")
        return float(np.asarray(content[key]).reshape(-1)[0])
    if mapping.fps is None:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps, or fps in the map")
    return mapping.fps


def _content(path: Path, keys: set[str]) -> dict[str, ndarray]:
    """The arrays of an npz by name, or the one of an npy under an empty name."""
    with reading(path, "npy or npz"), path.open("rb") as stream:
        archived = stream.read(2) == b"PK"
    return read_npz(path, keys, "npz") if archived else {"": read_npy(path, "npy")}
