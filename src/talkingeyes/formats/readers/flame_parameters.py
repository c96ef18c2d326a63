"""FLAME parameters of VHAP, DiffPoseTalk, EMOTE, ProbTalk3D, ARTalk, UniLS, and in our own layout.

All use rotation vectors (radians) for joints, the left eye before the right; eyes are relative to the head. Head and
neck are combined to one rotation, R(global) R(neck). The layout of an npz follows from its names, that of an array from
its width:

    53   EMOTE, DEEPTalk: 50 expression, 3 jaw           403  ProbTalk3D: 300 shape, 100 expression, 3 jaw
    106  ARTalk: 100 expression, 3 head, 3 jaw           108  UniLS: 100 expression, 3 head, 1 jaw, 2 + 2 eyes

UniLS stores x and y of an eye rotation; z is 0. Parts that a layout lacks are neutral.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import npz_names, read_npy, read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import CONVENTIONS, Motion
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note
from talkingeyes.formats.readers.torch_file import read_torch
from talkingeyes.formats.rotations import compose_rotations

HEAD_MODEL = "flame"
EXPRESSION = "expression_{:03d}"
# Alternative names in an npz, in order of precedence.
PARAMETER_ALIASES = {
    "global": ("rotation", "global_orient", "head_pose"),
    "neck": ("neck_pose",),
    "jaw": ("jaw_pose", "jaw"),
    "eyes": ("eyes_pose", "eye_pose"),
    "expression": ("expr", "exp", "expression"),
    "translation": ("translation", "transl"),
    "lid": ("eyelids",),
}
METADATA = {*CONVENTIONS, FORWARD_AXIS_KEY, "head_model", "fps"}  # beside the arrays of an npz
MIN_VERTEX_COLUMNS = 3000  # wider arrays hold vertices
POSE_KEYS = ("pose",)  # DiffPoseTalk: head and jaw in one array
EYE_KEYS = ("leye_pose", "reye_pose")  # one array an eye
LID_EXPRESSION = "eyelid_expr"  # ours: the part of the expression that moves the lids as `eyelids` does
PARAMETER_KEYS = {*POSE_KEYS, *EYE_KEYS, LID_EXPRESSION, *(key for keys in PARAMETER_ALIASES.values() for key in keys)}


def read_flame_npz(path: Path, fps: float | None = None) -> NotedMotion:
    """Read an npz of named FLAME parameters; of other arrays, the names are noted."""
    found = read_npz(path, {"fps", *PARAMETER_KEYS}, "npz")
    content = {name: array for name, array in found.items() if array.dtype.kind in "fiub"}
    return NotedMotion(motion_from_arrays(path, content, fps), array_notes(path))


def array_notes(path: Path) -> tuple[str, ...]:
    """What is said about the arrays of an npz that are no parameters of a motion."""
    names = [name for name in npz_names(path, "npz") if name not in METADATA]
    return no_place_note([name for name in names if name not in PARAMETER_KEYS], len(names), "arrays")


def read_flame_array(path: Path, fps: float | None = None) -> Motion:
    """Read an array (T, C) or (1, T, C), whose layout follows from its width; a .npy, or a tensor in a torch file."""
    content = read_torch(path) if path.suffix in (".pt", ".pth") else read_npy(path, "npy")
    if isinstance(content, Mapping):
        arrays = [value for value in content.values() if isinstance(value, ndarray) and value.ndim >= 2]
        if len(arrays) != 1:
            raise InputError(f"{path}: should hold one array of motion, got {len(arrays)}")
        content = arrays[0]
    array = np.asarray(content)
    array = array[0] if array.ndim == 3 and len(array) == 1 else array
    if array.ndim == 2 and array.shape[1] >= MIN_VERTEX_COLUMNS:
        from talkingeyes.formats.readers.vertices import read_vertices

        return read_vertices(path, array, fps)
    if array.ndim != 2 or array.shape[1] not in (53, 106, 108, 403) or array.dtype.kind != "f":
        raise InputError(f"{path}: should be (T, 53), (T, 106), (T, 108) or (T, 403) numbers, got {array.shape}")
    return motion_from_arrays(path, _split(array.astype(np.float64)), fps)


def motion_from_arrays(path: Path, content: Mapping[str, ndarray], fps: float | None) -> Motion:
    """Build a motion from named arrays. Raises InputError for a missing rate or inconsistent lengths."""
    found = {
        part: next((content[key] for key in keys if key in content), None) for part, keys in PARAMETER_ALIASES.items()
    }
    if found["expression"] is None and found["jaw"] is None and found["global"] is None:
        raise InputError(
            f"{path}: should hold FLAME parameters (expr, jaw_pose, ...), got {', '.join(content) or 'none'}"
        )
    pose = next((content[key] for key in POSE_KEYS if key in content), None)
    if pose is not None:
        rows = _rows(path, "pose", pose, 6)
        found |= {"global": rows[:, :3], "jaw": rows[:, 3:]}
    if all(name in content for name in EYE_KEYS):
        found["eyes"] = np.concatenate([_rows(path, name, content[name], 3) for name in EYE_KEYS], 1)
    rate = fps if fps is not None else _rate(path, content)
    frames = max(len(np.atleast_2d(array)) for array in found.values() if array is not None)

    def part(name: str, width: int) -> Float[ndarray, "T C"]:
        array = found[name]
        return np.zeros((frames, width)) if array is None else _rows(path, name, array, width, frames)

    expression = found["expression"]
    shown = np.zeros((frames, 0)) if expression is None else _rows(path, "expression", expression, None, frames)
    if LID_EXPRESSION in content:
        shown = shown - _rows(path, LID_EXPRESSION, content[LID_EXPRESSION], shown.shape[1], frames)
    return Motion.of(
        rate,
        compose_rotations(part("global", 3), part("neck", 3)),
        part("eyes", 6).reshape(frames, 2, 3),
        translation=part("translation", 3),
        lid=part("lid", 2),
        jaw=part("jaw", 3),
        expression=shown,
        expression_names=tuple(EXPRESSION.format(number) for number in range(shown.shape[1])),
        head_model=HEAD_MODEL,
    )


def _split(array: Float[ndarray, "T C"]) -> dict[str, ndarray]:
    """Parts of an array, by its width."""
    frames, width = array.shape
    if width == 53:
        return {"expr": array[:, :50], "jaw_pose": array[:, 50:]}
    if width == 403:
        return {"expr": array[:, 300:400], "jaw_pose": array[:, 400:]}
    if width == 106:
        return {"expr": array[:, :100], "head_pose": array[:, 100:103], "jaw_pose": array[:, 103:]}
    none = np.zeros((frames, 1))
    return {
        "expr": array[:, :100],
        "head_pose": array[:, 100:103],
        "jaw_pose": np.concatenate([array[:, 103:104], none, none], axis=1),
        "eyes_pose": np.concatenate([array[:, 104:106], none, array[:, 106:108], none], axis=1),
    }


def _rows(path: Path, name: str, array: ndarray, width: int | None, frames: int | None = None) -> ndarray:
    """An array of T rows; a single row is repeated for all frames."""
    rows = np.asarray(array, np.float64)
    rows = rows.reshape(len(rows), -1) if rows.ndim > 1 else np.atleast_2d(rows)
    if frames is not None and len(rows) == 1 < frames:
        rows = np.repeat(rows, frames, axis=0)
    if (width is not None and rows.shape[1] != width) or (frames is not None and len(rows) != frames):
        raise InputError(f"{path}: {name} should be ({frames or 'T'}, {width or 'C'}), got {np.shape(array)}")
    if not np.isfinite(rows).all():
        raise InputError(f"{path}: {name} holds NaN or infinite values")
    return rows


def _rate(path: Path, content: Mapping[str, ndarray]) -> float:
    if "fps" not in content:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps")
    return float(np.asarray(content["fps"]).reshape(-1)[0])
