"""The head model record, for the open head (`anny`) and FLAME (`flame`), in head coordinates.

The origin is the neck joint, about which `Motion.head` rotates; +x to the subject's left, y up, +z out of the face, in
metres. A vertex is template + identity + expression + pose correctives (Loper et al. 2015, eq. 2), then linear blend
skinning over five joints (`skinning`). Blend shapes are displacements at weight 1. Eyes in the order left, right.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_npz, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.npz import save_npz

JOINTS = ("root", "neck", "jaw", "left_eye", "right_eye")
PARENTS = (-1, 0, 1, 1, 1)
LOOK_PARTS = ("hair", "lash", "waterline", "cloth")  # parts that looks add (`looks`)
# parts of the mesh that a face can belong to
PARTS = ("skin", "lips", "brow", "sclera", "iris", "pupil", "teeth", "tongue", "tissue", *LOOK_PARTS)
SCHEMA = "talkingeyes.head/1"
LANDMARK_SETS = ("landmarks", "brows")


@dataclass(frozen=True)
class Landmarks:
    """Named points of the surface: three vertices and their barycentric weights (a vertex: 1, 0, 0)."""

    names: tuple[str, ...]
    corners: Int[ndarray, "L 3"]
    barycentric: Float[ndarray, "L 3"]

    def of(self, vertices: Float[ndarray, "*N V C"]) -> Float[ndarray, "*N L C"]:
        """Interpolate vertex positions, or other vertex attributes, at the points."""
        return np.asarray(np.einsum("...lkd,lk->...ld", vertices[..., self.corners, :], self.barycentric))


NO_LANDMARKS = Landmarks((), np.zeros((0, 3), np.int32), np.zeros((0, 3)))


@dataclass(frozen=True)
class HeadModel:
    """A head that can be posed. `parts` are indices into PARTS; colours are linear albedo from 0 to 1.

    `ambient` is the fraction of the sky visible from a vertex of the template. `correctives` are FLAME's, driven by the
    entries of R - I of neck, jaw and eyes; other heads have none. `jaw_open_rad` is the jaw angle at weight 1 of
    `jawOpen`, for heads that open their mouth by a blend shape, else 0. `pupils` are the apexes of the corneas,
    `irises` the vertices of the circle where cornea and sclera meet. `brows` are the points of the skin under the
    vertices of the part brow, if that is a separate strip.
    """

    name: str
    template: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    parts: Int[ndarray, " F"]
    colours: Float[ndarray, "V 3"]
    ambient: Float[ndarray, " V"]
    identity: Float[ndarray, "I V 3"]
    identity_joints: Float[ndarray, "I 5 3"]
    identity_names: tuple[str, ...]
    expression: Float[ndarray, "E V 3"]
    expression_names: tuple[str, ...]
    correctives: Float[ndarray, "P V 3"]
    joints: Float[ndarray, "5 3"]
    weights: Float[ndarray, "V 5"]
    landmarks: Landmarks
    irises: Int[ndarray, "2 K"]
    pupils: Int[ndarray, " 2"]
    jaw_open_rad: float
    brows: Landmarks = NO_LANDMARKS

    def __post_init__(self) -> None:
        vertices, shapes, people = len(self.template), len(self.expression_names), len(self.identity_names)
        expected = {
            "colours": (vertices, 3),
            "ambient": (vertices,),
            "identity": (people, vertices, 3),
            "identity_joints": (people, 5, 3),
            "expression": (shapes, vertices, 3),
            "correctives": (len(self.correctives), vertices, 3),
            "joints": (5, 3),
            "weights": (vertices, 5),
            "parts": (len(self.faces),),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise InputError(f"head {self.name}: {name} should have shape {shape}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"head {self.name}: {name} should be finite, got NaN or infinite values")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < vertices:
            raise InputError(
                f"head {self.name}: faces should name vertices 0 to {vertices - 1}, got {self.faces.max()}"
            )

    @property
    def eye_centres(self) -> Float[ndarray, "2 3"]:
        """Rotation centres of the eyeballs, in head coordinates."""
        return self.joints[3:]

    def shape(self, name: str) -> int:
        """The index of an expression shape."""
        return self.expression_names.index(name)

    def vertices_of(self, *parts: str) -> Int[ndarray, " N"]:
        """The vertices of the faces of these parts, in order."""
        wanted = np.isin(self.parts, [PARTS.index(part) for part in parts])
        return np.unique(self.faces[wanted])


def save_head(model: HeadModel, path: Path) -> None:
    """Write the head as npz without pickles, atomically."""
    content: dict[str, ndarray] = {"schema": np.str_(SCHEMA)}  # type: ignore[dict-item]
    for field in fields(HeadModel):
        value = getattr(model, field.name)
        if isinstance(value, Landmarks):
            content |= {f"{field.name}_{name}": np.asarray(getattr(value, name)) for name in LANDMARK_FIELDS}
        else:
            content[field.name] = np.array(value, np.str_) if isinstance(value, tuple) else np.asarray(value)
    with atomic_write(path) as partial:
        save_npz(partial, **content)


def load_head(path: Path) -> HeadModel:
    """Read a head written by `save_head`. Raises InputError for other files or another schema."""
    names = [field.name for field in fields(HeadModel) if field.name not in LANDMARK_SETS]
    needed = [*names, *(f"{points}_{name}" for points in LANDMARK_SETS for name in LANDMARK_FIELDS)]
    content = read_npz(path, {"schema", *needed}, "head")
    missing = [name for name in needed if name not in content]
    if str(content.get("schema", "none")) != SCHEMA or missing:
        raise InputError(f"{path}: should be a head of schema {SCHEMA}, got {content.get('schema', 'none')} {missing}")
    with reading(path, "head"):
        arrays: dict[str, Any] = {name: _plain(content[name]) for name in names}
        points: dict[str, Any] = {
            name: Landmarks(
                _texts(content[f"{name}_names"]), content[f"{name}_corners"], content[f"{name}_barycentric"]
            )
            for name in LANDMARK_SETS
        }
        return HeadModel(**points, **arrays)


LANDMARK_FIELDS = tuple(field.name for field in fields(Landmarks))


def _texts(array: ndarray) -> tuple[str, ...]:
    return tuple(str(name) for name in array)


def _plain(array: ndarray) -> Any:
    """Values of the record: arrays unchanged, texts as tuples, scalars as Python values."""
    if array.ndim == 0:
        return array.item()
    return _texts(array) if array.dtype.kind == "U" else array
