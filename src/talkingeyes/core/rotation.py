"""Rotation vectors, gaze angles and Listing's law.

Axes: right-handed, y up, +z out of the face, +x to the subject's left, radians. A rotation vector with +x looks down,
+y turns to the subject's left, +z tilts to the subject's right shoulder. Gaze angles are `yaw_rad` (positive to the
subject's left) and `pitch_rad` (positive up). Gaze in space is R(head) R(eye); eyes are in the order left, right.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation


def rotvec_to_matrix(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3 3"]:
    """Rotation matrices of rotation vectors (radians)."""
    flat = Rotation.from_rotvec(np.reshape(rotation_vectors, (-1, 3))).as_matrix()
    return np.reshape(flat, (*np.shape(rotation_vectors), 3))


def matrix_to_rotvec(rotation_matrices: Float[ndarray, "*N 3 3"]) -> Float[ndarray, "*N 3"]:
    """Rotation vectors (radians) of rotation matrices; the inverse of `rotvec_to_matrix`."""
    flat = Rotation.from_matrix(np.reshape(rotation_matrices, (-1, 3, 3))).as_rotvec()
    return np.reshape(flat, np.shape(rotation_matrices)[:-1])


def rotvec_to_direction(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Unit vectors to which the rotations map +z."""
    return rotvec_to_matrix(rotation_vectors)[..., :, 2]


def direction_to_rotvec(direction: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Torsion-free rotation vectors that map +z to the unit vectors (Listing's law: the z component is 0)."""
    sine = np.hypot(direction[..., 0], direction[..., 1])
    angle = np.arctan2(sine, direction[..., 2])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)
    return np.stack([-direction[..., 1] * scale, direction[..., 0] * scale, np.zeros_like(sine)], axis=-1)


def angles_to_direction(angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 3"]:
    """Unit vectors of (yaw, pitch): (sin yaw cos pitch, sin pitch, cos yaw cos pitch)."""
    yaw, pitch = angles_rad[..., 0], angles_rad[..., 1]
    return np.stack([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)], axis=-1)


def direction_to_angles(direction: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
    """(yaw, pitch) of unit vectors; the inverse of `angles_to_direction`."""
    return np.stack(
        [
            np.arctan2(direction[..., 0], direction[..., 2]),
            np.arctan2(direction[..., 1], np.hypot(direction[..., 0], direction[..., 2])),
        ],
        axis=-1,
    )


def angles_to_gaze(angles_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 3"]:
    """Torsion-free eye rotation vectors of (yaw, pitch)."""
    return direction_to_rotvec(angles_to_direction(angles_rad))


def gaze_to_angles(rotation_vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
    """(yaw, pitch) of the direction of rotation vectors; torsion is dropped."""
    return direction_to_angles(rotvec_to_direction(rotation_vectors))


def gaze_in_space(head: Float[ndarray, "*N 3"], gaze: Float[ndarray, "*N E 3"]) -> Float[ndarray, "*N E 2"]:
    """Direction of gaze in space as (yaw, pitch): R(head) R(eye) applied to +z."""
    return direction_to_angles(np.einsum("...ij,...ej->...ei", rotvec_to_matrix(head), rotvec_to_direction(gaze)))


def cyclopean_gaze(gaze_in_space_rad: Float[ndarray, "*N E 2"]) -> Float[ndarray, "*N 2"]:
    """Cyclopean gaze: (yaw, pitch) of the mean direction of both eyes."""
    return direction_to_angles(angles_to_direction(gaze_in_space_rad).mean(axis=-2))


def eye_in_head(head: Float[ndarray, "*N 3"], gaze_in_space_rad: Float[ndarray, "*N E 2"]) -> Float[ndarray, "*N E 3"]:
    """Torsion-free eye rotation vectors for gaze direction `gaze_in_space_rad` with head rotation `head`.

    The inverse of `gaze_in_space`: this product is the counter-rotation of the eyes (vestibulo-ocular reflex, gain 1).
    """
    return direction_to_rotvec(angles_to_direction(gaze_in_space_rad) @ rotvec_to_matrix(head))
