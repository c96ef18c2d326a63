"""Rotation vectors, gaze angles and Listing's law.

Axes: right-handed, y up, +z out of the face, +x to the subject's left, radians. A rotation vector with +x looks down,
+y turns to the subject's left, +z tilts to the subject's right shoulder. Gaze angles are `yaw_rad` (positive to the
subject's left) and `pitch_rad` (positive up). Gaze in space is R(head) R(eye); eyes stand in the order left, right.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

FORWARD = np.array([0.0, 0.0, 1.0])


def matrices(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3 3"]:
    """Rotation matrices of rotation vectors (radians)."""
    flat = Rotation.from_rotvec(np.reshape(rotation_vectors, (-1, 3))).as_matrix()
    return np.reshape(flat, (*np.shape(rotation_vectors), 3))


def vectors(rotation_matrices: Float[ndarray, "*N 3 3"]) -> Float[ndarray, "*N 3"]:
    """Rotation vectors (radians) of rotation matrices; the inverse of `matrices`."""
    flat = Rotation.from_matrix(np.reshape(rotation_matrices, (-1, 3, 3))).as_rotvec()
    return np.reshape(flat, np.shape(rotation_matrices)[:-1])


def directions(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Where +z goes under the rotations: unit vectors."""
    return matrices(rotation_vectors)[..., :, 2]


def listing(unit: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Torsion-free rotation vectors that turn +z to the unit vectors (Listing's law: the z component is 0)."""
    sine = np.hypot(unit[..., 0], unit[..., 1])
    angle = np.arctan2(sine, unit[..., 2])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)
    return np.stack([-unit[..., 1] * scale, unit[..., 0] * scale, np.zeros_like(sine)], axis=-1)


def direction_of_angles(angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 3"]:
    """Unit vectors of (yaw, pitch): (sin yaw cos pitch, sin pitch, cos yaw cos pitch)."""
    yaw, pitch = angles_rad[..., 0], angles_rad[..., 1]
    return np.stack([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)], axis=-1)


def angles_of_direction(unit: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
    """(yaw, pitch) of unit vectors; the inverse of `direction_of_angles`."""
    return np.stack(
        [np.arctan2(unit[..., 0], unit[..., 2]), np.arctan2(unit[..., 1], np.hypot(unit[..., 0], unit[..., 2]))],
        axis=-1,
    )


def gaze_of_angles(angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 3"]:
    """Eye rotation vectors without torsion of (yaw, pitch)."""
    return listing(direction_of_angles(angles_rad))


def angles_of_gaze(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
    """(yaw, pitch) of the direction of rotation vectors; torsion is dropped."""
    return angles_of_direction(directions(rotation_vectors))


def gaze_in_space(head: Float[ndarray, "*N 3"], gaze: Float[ndarray, "*N E 3"]) -> Float[ndarray, "*N E 2"]:
    """Direction of gaze in space as (yaw, pitch): R(head) R(eye) applied to +z."""
    return angles_of_direction(np.einsum("...ij,...ej->...ei", matrices(head), directions(gaze)))


def conjugate(space_rad: Float[ndarray, "*N E 2"]) -> Float[ndarray, "*N 2"]:
    """Where both eyes look together: (yaw, pitch) of the mean of their directions."""
    return angles_of_direction(direction_of_angles(space_rad).mean(axis=-2))


def eye_in_head(head: Float[ndarray, "*N 3"], space_rad: Float[ndarray, "*N E 2"]) -> Float[ndarray, "*N E 3"]:
    """Torsion-free eye rotation vectors that look in direction `space_rad` from a head turned by `head`.

    The inverse of `gaze_in_space`: the counter-rotation of the eyes (vestibulo-ocular reflex, gain 1) is this product.
    """
    return listing(direction_of_angles(space_rad) @ matrices(head))
