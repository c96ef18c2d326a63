"""Conversion between points in metres and directions of gaze, with the line of sight of each eye.

A Motion's gaze is the optical axis of each eye, which the pupil shows. The line of sight, which falls on the target,
deviates from it by kappa (docs/conventions.md); here the mean kappa of people is used, as in the models' gaze. Both
eyes aim at the target, so its distance gives the vergence. Angles are (yaw, pitch); points are in metres from between
the eyes of the head at rest.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.physiology import eye_head
from talkingeyes.physiology.vergence import HALF_INTERPUPILLARY_M
from talkingeyes.synthesis.speakers import KAPPA_DEG, KAPPA_DOWN_DEG

EYES_M = np.array([[HALF_INTERPUPILLARY_M, 0.0, 0.0], [-HALF_INTERPUPILLARY_M, 0.0, 0.0]])
# From the rotation centre of the head to the point between the eyes, in the open head.
BETWEEN_EYES_M = np.array([0.0, 0.041374, 0.084397])
KAPPA_RAD = np.radians([[KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]], [-KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]]])

CoordinateFrame = Literal["world", "head"]


def optical_axes_rad(
    head: Float[ndarray, "T 3"], points_m: Float[ndarray, "T 3"], frame: CoordinateFrame
) -> Float[ndarray, "T 2 2"]:
    """Directions in space of both optical axes when the lines of sight meet at a point, clamped to the eye range."""
    head_rotation = rotation.rotvec_to_matrix(head)
    seen = _from_eyes(head_rotation, points_m, frame)
    angles = rotation.direction_to_angles(seen / np.linalg.norm(seen, axis=-1, keepdims=True)) + KAPPA_RAD
    axes = rotation.angles_to_direction(eye_head.clamp_angles(angles))
    return rotation.direction_to_angles(np.einsum("tij,tej->tei", head_rotation, axes))


def gaze_error_rad(
    head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"], points_m: Float[ndarray, "T 3"], frame: CoordinateFrame
) -> Float[ndarray, "T 2"]:
    """Angle between the line of sight of each eye and the direction to a point."""
    wanted = _from_eyes(rotation.rotvec_to_matrix(head), points_m, frame)
    sight = rotation.angles_to_direction(rotation.gaze_to_angles(gaze) - KAPPA_RAD)
    beside = np.linalg.norm(np.cross(sight, wanted), axis=-1)
    return np.asarray(np.arctan2(beside, (sight * wanted).sum(axis=-1)))


def cyclopean_line_of_sight_rad(gaze_in_space_rad: Float[ndarray, "T 2 2"]) -> Float[ndarray, "T 2"]:
    """Cyclopean line of sight: the mean of both optical axes minus the mean kappa."""
    return np.asarray(gaze_in_space_rad.mean(axis=1) - KAPPA_RAD.mean(axis=0))


def point_direction_rad(head: Float[ndarray, "T 3"], points_m: Float[ndarray, "T 3"]) -> Float[ndarray, "T 2"]:
    """Direction in space to a point in world coordinates from between the eyes of a turned head."""
    seen = points_m + BETWEEN_EYES_M - np.einsum("tij,j->ti", rotation.rotvec_to_matrix(head), BETWEEN_EYES_M)
    return rotation.direction_to_angles(seen / np.linalg.norm(seen, axis=-1, keepdims=True))


def _from_eyes(
    head_rotation: Float[ndarray, "T 3 3"], points_m: Float[ndarray, "T 3"], frame: CoordinateFrame
) -> Float[ndarray, "T 2 3"]:
    """Vectors from each eye to a point, in head coordinates."""
    if frame == "world":
        points_m = np.einsum("tji,tj->ti", head_rotation, points_m + BETWEEN_EYES_M) - BETWEEN_EYES_M
    return np.asarray(points_m[:, None] - EYES_M)
