"""FLAME as a head: reads the user's `generic_model.pkl` (2020), `flame2023.pkl` or `flame2023_Open.pkl`.

Li, Bolkart, Black, Li & Romero, "Learning a model of facial shape and expression from 4D scans" (2017). This project
does not include FLAME data. The three editions have the same layout: 5,023 vertices (skin 0 to 3930, the subject's left
eyeball 3931 to 4476, right 4477 to 5022), 300 shape and 100 expression components, joints root, neck, jaw, left eye,
right eye, and 36 pose correctives driven by the entries of R - I of the last four joints. The file is a pickle of
chumpy objects, read without chumpy and without executing it (`restricted_pickle`). Joints depend on identity only, as
in the paper's eq. 2. `landmark_embedding.npy`, distributed with FLAME, defines the 68 landmarks; it is optional.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.head.eyelid.blendshapes import lid_landmarks, with_eyelids
from talkingeyes.head.model import PARENTS, PARTS, HeadModel, Landmarks
from talkingeyes.head.restricted_pickle import as_array, read_pickle

VERTICES, FACES, SHAPES, EXPRESSIONS, CORRECTIVES = 5023, 9976, 300, 100, 36
EYEBALLS = (slice(3931, 4477), slice(4477, 5023))
PUPILS = (4051, 4597)  # apexes of the corneas, on the optical axis
# angle of the iris circle (5.9 mm on a ball of 12.6) and of the pupil from the optical axis
IRIS_RAD, PUPIL_RAD = 0.487, 0.14
IRIS_VERTICES = 32  # number of vertices on a circle around the optical axis
COLOURS = {"skin": (0.72, 0.47, 0.36), "sclera": (0.86, 0.84, 0.80), "iris": (0.13, 0.26, 0.36), "pupil": (0.01,) * 3}

ARRAY_SHAPES = {
    "v_template": (VERTICES, 3),
    "shapedirs": (VERTICES, 3, SHAPES + EXPRESSIONS),
    "posedirs": (VERTICES, 3, CORRECTIVES),
    "J_regressor": (5, VERTICES),
    "weights": (VERTICES, 5),
    "kintree_table": (2, 5),
    "f": (FACES, 3),
}
# Index among the 68 landmarks (Gross et al., Multi-PIE) of each of our landmark names that has one.
MULTI_PIE_INDEX = {
    **dict(zip([f"left_eye_{at}" for at in ("outer", "upper_outer", "upper_inner")], (45, 44, 43), strict=True)),
    **dict(zip([f"left_eye_{at}" for at in ("inner", "lower_inner", "lower_outer")], (42, 47, 46), strict=True)),
    **dict(zip([f"right_eye_{at}" for at in ("outer", "upper_outer", "upper_inner")], (36, 37, 38), strict=True)),
    **dict(zip([f"right_eye_{at}" for at in ("inner", "lower_inner", "lower_outer")], (39, 40, 41), strict=True)),
    **dict(zip([f"left_brow_{at}" for at in ("outer", "middle", "inner")], (26, 24, 22), strict=True)),
    **dict(zip([f"right_brow_{at}" for at in ("outer", "middle", "inner")], (17, 19, 21), strict=True)),
    **{"left_nose_wing": 35, "right_nose_wing": 31, "left_mouth_corner": 54, "right_mouth_corner": 48},
    **{"nose_bridge": 27, "nose_middle": 28, "nose_tip": 30, "nose_base": 33, "outline_chin": 8},
    **{"upper_lip": 51, "upper_lip_inner": 62, "lower_lip_inner": 66, "lower_lip": 57},
}


@dataclass(frozen=True)
class FlameFile:
    """The arrays of a model file, in its own coordinates."""

    template: Float[ndarray, "V 3"]
    directions: Float[ndarray, "V 3 D"]
    correctives: Float[ndarray, "V 3 P"]
    regressor: Float[ndarray, "5 V"]
    weights: Float[ndarray, "V 5"]
    faces: Int[ndarray, "F 3"]


def load_flame(
    path: Path,
    embedding: Path | None = None,
    shape: Float[ndarray, " I"] | None = None,
    offset: Float[ndarray, "V 3"] | None = None,
) -> HeadModel:
    """Load a FLAME head, with lids of the Eyelid model. Raises InputError if the file is not a FLAME model.

    `shape` are the first components of a person's identity, `offset` displacements of the vertices besides (metres).
    """
    file = read_flame(path)
    if shape is not None:
        file = replace(file, template=file.template + file.directions[..., : len(shape)] @ shape)
    if offset is not None:
        file = replace(file, template=file.template + offset)
    joints = file.regressor @ file.template
    faces = file.faces.astype(np.int64)
    parts, irises = _parts(file.template, faces, joints[3:])
    colours = np.tile(np.array(COLOURS["skin"]), (VERTICES, 1))
    for part in ("sclera", "iris", "pupil"):
        colours[np.unique(faces[parts == PARTS.index(part)])] = COLOURS[part]
    directions = np.moveaxis(file.directions, -1, 0)
    head = HeadModel(
        name="flame",
        template=file.template - joints[1],
        faces=faces,
        parts=parts,
        colours=colours,
        ambient=np.ones(VERTICES),
        identity=directions[:SHAPES],
        identity_joints=np.einsum("jv,ivd->ijd", file.regressor, directions[:SHAPES], optimize=True),
        identity_names=tuple(f"shape_{number:03d}" for number in range(SHAPES)),
        expression=directions[SHAPES:],
        expression_names=tuple(f"expression_{number:03d}" for number in range(EXPRESSIONS)),
        correctives=np.moveaxis(file.correctives, -1, 0),
        joints=joints - joints[1],
        weights=file.weights,
        landmarks=_no_landmarks() if embedding is None else read_landmarks(embedding, faces),
        irises=irises,
        pupils=np.array(PUPILS),
        jaw_open_rad=0.0,
    )
    found = head if embedding is not None else replace(head, landmarks=lid_landmarks(head))
    return with_eyelids(found, EyelidParameters())


def read_flame(path: Path) -> FlameFile:
    """Read and check the arrays of a FLAME pickle: shapes, joints and finite values. Raises InputError."""
    content = read_pickle(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: should be a FLAME model, a dictionary, got {type(content).__name__}")
    arrays = {name: _array(path, content, name) for name in ARRAY_SHAPES}
    if tuple(int(parent) for parent in arrays["kintree_table"][0][1:]) != PARENTS[1:]:
        raise InputError(f"{path}: joints should have parents {PARENTS}, got {arrays['kintree_table'][0].tolist()}")
    faces = arrays["f"].astype(np.int64)
    if faces.min() < 0 or faces.max() >= VERTICES:
        raise InputError(f"{path}: faces should name vertices 0 to {VERTICES - 1}, got {faces.min()} to {faces.max()}")
    floats = {name: arrays[name].astype(np.float64) for name in ARRAY_SHAPES if name not in ("f", "kintree_table")}
    return FlameFile(
        template=floats["v_template"],
        directions=floats["shapedirs"],
        correctives=floats["posedirs"],
        regressor=floats["J_regressor"],
        weights=floats["weights"],
        faces=faces,
    )


def read_landmarks(path: Path, faces: Int[ndarray, "F 3"]) -> Landmarks:
    """Read the named landmarks from `landmark_embedding.npy`, a pickled dictionary, without executing it."""
    content = as_array(read_pickle(path, skip_bytes=_npy_header_bytes(path)))
    content = content.item() if content.shape == () or content.size == 1 else content
    try:
        triangles = as_array(content["full_lmk_faces_idx"]).reshape(-1).astype(np.int64)
        barycentric = as_array(content["full_lmk_bary_coords"]).reshape(-1, 3).astype(np.float64)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise InputError(f"{path}: should hold full_lmk_faces_idx and full_lmk_bary_coords ({error!r})") from None
    if triangles.shape != (68,) or barycentric.shape != (68, 3) or not 0 <= triangles.min() <= triangles.max() < FACES:
        raise InputError(f"{path}: should hold 68 landmarks on {FACES} faces, got {len(triangles)}")
    places = list(MULTI_PIE_INDEX.values())
    return Landmarks(tuple(MULTI_PIE_INDEX), faces[triangles[places]], barycentric[places])


def _array(path: Path, content: dict[str, Any], name: str) -> ndarray:
    shape = ARRAY_SHAPES[name]
    if name not in content:
        raise InputError(f"{path}: a FLAME model should hold {name} {shape}, got {', '.join(map(str, content))}")
    try:
        array = as_array(content[name])
        finite = bool(np.isfinite(array).all())
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{path}: {name} should be an array of numbers, got {error}") from None
    if array.shape != shape:
        raise InputError(f"{path}: {name} should have shape {shape}, got {array.shape}")
    if not finite:
        raise InputError(f"{path}: {name} should be finite, got NaN or infinite values")
    return array


def _parts(
    template: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], centres: Float[ndarray, "2 3"]
) -> tuple[Int[ndarray, " F"], Int[ndarray, "2 K"]]:
    """Part of each face, and the vertices nearest to the iris circle of each eyeball, ordered around its axis."""
    parts = np.full(len(faces), PARTS.index("skin"))
    irises = []
    for ball, centre in zip(EYEBALLS, centres, strict=True):
        out = template[ball] - centre
        angle = np.arctan2(np.hypot(out[:, 0], out[:, 1]), out[:, 2])
        ring = np.argsort(np.abs(angle - IRIS_RAD), kind="stable")[:IRIS_VERTICES]
        around = np.arctan2(out[ring, 1], out[ring, 0])
        irises.append(ball.start + ring[np.argsort(around, kind="stable")])
        of_vertex = np.full(VERTICES, np.nan)
        of_vertex[ball] = angle
        middle = of_vertex[faces].mean(axis=1)  # NaN for the skin
        parts[middle >= IRIS_RAD] = PARTS.index("sclera")
        parts[middle < IRIS_RAD] = PARTS.index("iris")
        parts[middle < PUPIL_RAD] = PARTS.index("pupil")
    return parts, np.stack(irises)


def _npy_header_bytes(path: Path) -> int:
    """Offset of the pickle in an .npy file of objects: magic, version, length of the header, header."""
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            size = 2 if version == (1, 0) else 4
            length = int.from_bytes(file.read(size), "little")
            header = ast.literal_eval(file.read(length).decode("latin1"))
            if header["descr"] != "|O":
                raise InputError(f"{path}: should be a landmark embedding (an array of objects), got {header['descr']}")
            return file.tell()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (ValueError, SyntaxError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a readable landmark embedding ({error})") from None


def _no_landmarks() -> Landmarks:
    return Landmarks((), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
