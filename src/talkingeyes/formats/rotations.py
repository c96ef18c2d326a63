"""Conversion of the rotation formats of files from and to rotation vectors."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError

WIDTHS = {"rotation_vector": 3, "six_d": 6, "quaternion_xyzw": 4, "quaternion_wxyz": 4, "matrix": 9, "yaw_pitch": 2}
EULER_PREFIX = "euler_"  # plus three letters: capitals for intrinsic (XYZ), small letters for extrinsic rotations


def rotation_width(rotation_format: str) -> int:
    """Numbers per rotation of a format. Raises InputError for an unknown format."""
    letters = rotation_format.removeprefix(EULER_PREFIX)
    if (
        rotation_format.startswith(EULER_PREFIX)
        and sorted(letters.lower()) == ["x", "y", "z"]
        and (letters.isupper() or letters.islower())
    ):
        return 3
    if rotation_format not in WIDTHS:
        raise InputError(
            f"rotation_format: should be one of {', '.join(WIDTHS)} or {EULER_PREFIX}XYZ (any order), "
            f"got {rotation_format!r}"
        )
    return WIDTHS[rotation_format]


def to_rotation_vectors(values: Float[ndarray, "T C"], rotation_format: str) -> Float[ndarray, "T 3"]:
    """Convert to rotation vectors (radians). `six_d` holds the first two rows of the matrix; angles are in radians."""
    if rotation_format == "rotation_vector":
        return np.asarray(values)
    if rotation_format == "yaw_pitch":
        return rotation.angles_to_gaze(values)
    if rotation_format.startswith(EULER_PREFIX):
        return np.asarray(Rotation.from_euler(rotation_format.removeprefix(EULER_PREFIX), values).as_rotvec())
    if rotation_format == "six_d":
        return rotation.matrix_to_rotvec(_orthonormal(values))
    if rotation_format == "matrix":
        return rotation.matrix_to_rotvec(values.reshape(-1, 3, 3))
    return np.asarray(Rotation.from_quat(values, scalar_first=rotation_format == "quaternion_wxyz").as_rotvec())


def euler_yxz(vectors: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    """Intrinsic Euler angles about y, x, z (radians): yaw to the left, pitch down, roll to the right shoulder."""
    return np.asarray(Rotation.from_rotvec(vectors).as_euler("YXZ"))


def from_euler_yxz(angles_rad: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    """The inverse of `euler_yxz`."""
    return np.asarray(Rotation.from_euler("YXZ", angles_rad).as_rotvec())


def quaternions(vectors: Float[ndarray, "T 3"]) -> Float[ndarray, "T 4"]:
    """Unit quaternions x, y, z, w with signs chosen for continuity, so that players interpolate along the shorter
    arc."""
    found = Rotation.from_rotvec(vectors).as_quat()
    flips = np.sign(np.einsum("tc,tc->t", found[1:], found[:-1]))
    flips[flips == 0] = 1.0
    return np.asarray(found * np.concatenate([[1.0], np.cumprod(flips)])[:, None])


def compose_rotations(first: Float[ndarray, "T 3"], second: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    """The rotation vectors of R(first) R(second)."""
    return rotation.matrix_to_rotvec(rotation.rotvec_to_matrix(first) @ rotation.rotvec_to_matrix(second))


def _orthonormal(values: Float[ndarray, "T 6"]) -> Float[ndarray, "T 3 3"]:
    """Gram-Schmidt orthonormalisation of two rows (Zhou et al. 2019, as in pytorch3d)."""
    first, second = values[:, :3], values[:, 3:]
    one = first / np.linalg.norm(first, axis=1, keepdims=True)
    two = second - np.einsum("tc,tc->t", one, second)[:, None] * one
    two = two / np.linalg.norm(two, axis=1, keepdims=True)
    return np.stack([one, two, np.cross(one, two)], axis=1)
