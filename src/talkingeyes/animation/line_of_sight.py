"""Conversion between optical axes, lines of sight, and points in metres.

A Motion's gaze is the optical axis of each eye, which the pupil shows. The line of sight, which falls on the target,
deviates from it by kappa (docs/conventions.md); here the mean kappa of people is used, as in the models' gaze. A head
whose pupils lie on the forward axes of its eyes, as in rigs and in the open head, looks at the target if these axes are
the lines of sight: `to_forward_axes`. Both eyes aim at the target, so its distance gives the vergence
(`head.eyelid.gaze_controller`). Angles are (yaw, pitch); targets are homogeneous coordinates (x, y, z, w), metres from
between the eyes of the head at rest; w = 0 is infinity.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.eyelid.gaze_controller import aim_eyes
from talkingeyes.physiology import eye_head
from talkingeyes.physiology.vergence import HALF_INTERPUPILLARY_M
from talkingeyes.synthesis.speakers import KAPPA_DEG, KAPPA_DOWN_DEG

EYES_M = np.array([[HALF_INTERPUPILLARY_M, 0.0, 0.0], [-HALF_INTERPUPILLARY_M, 0.0, 0.0]])
# From the rotation centre of the head to the point between the eyes, in the open head.
BETWEEN_EYES_M = np.array([0.0, 0.041374, 0.084397])
# (yaw, pitch) from the line of sight to the optical axis of each eye: to the temple, and down.
MEAN_KAPPA_RAD = np.radians([[KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]], [-KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]]])

CoordinateFrame = Literal["world", "head"]
ForwardAxis = Literal["visual", "optical"]  # what the forward axis of a head's eyes is: line of sight or optical axis


def to_forward_axes(motion: Motion, eyes: str = "visual") -> Motion:
    """The motion with the forward axes of the eyes of a rig as gaze; `from_forward_axes` is the inverse.

    `visual`: the lines of sight, for eyes whose pupils lie on their forward axes. `optical`: the motion itself, for
    eyes that are compared with photographs. Gaze that is 0 throughout is eyes at rest, not a direction, and stays 0.
    """
    return _shift_gaze(motion, -MEAN_KAPPA_RAD) if check_forward_axis(eyes) == "visual" else motion


def from_forward_axes(motion: Motion, eyes: str) -> Motion:
    """The motion (gaze: optical axes) of one whose gaze is the forward axes of the eyes of a rig."""
    return _shift_gaze(motion, MEAN_KAPPA_RAD) if check_forward_axis(eyes) == "visual" else motion


def check_forward_axis(eyes: str) -> str:
    """Return `eyes`. Raises InputError unless it is a ForwardAxis."""
    if eyes not in get_args(ForwardAxis):
        raise InputError(f"eyes: should be one of {', '.join(get_args(ForwardAxis))}, got {eyes!r}")
    return eyes


def _shift_gaze(motion: Motion, shift_rad: Float[ndarray, "2 2"]) -> Motion:
    """Add angles (yaw, pitch) to the directions of both eyes; torsion (twist about the axis) is kept."""
    if not motion.gaze.any():
        return motion
    angles = rotation.gaze_to_angles(motion.gaze)
    before, after = (rotation.rotvec_to_matrix(rotation.angles_to_gaze(each)) for each in (angles, angles + shift_rad))
    turned = after @ np.swapaxes(before, -1, -2) @ rotation.rotvec_to_matrix(motion.gaze)
    return replace(motion, gaze=rotation.matrix_to_rotvec(turned))


def optical_axes_rad(
    head: Float[ndarray, "T 3"], targets: Float[ndarray, "T 4"], frame: CoordinateFrame
) -> Float[ndarray, "T 2 2"]:
    """Directions in space of both optical axes when the lines of sight meet at a target, clamped to the eye range."""
    angles = eye_head.clamp_angles(_sight_rad(head, targets, frame) + MEAN_KAPPA_RAD)
    axes = rotation.angles_to_direction(angles)
    return rotation.direction_to_angles(np.einsum("tij,tej->tei", rotation.rotvec_to_matrix(head), axes))


def gaze_error_rad(
    head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"], targets: Float[ndarray, "T 4"], frame: CoordinateFrame
) -> Float[ndarray, "T 2"]:
    """Angle between the line of sight of each eye and the direction to a target."""
    wanted = rotation.angles_to_direction(_sight_rad(head, targets, frame))
    sight = rotation.angles_to_direction(rotation.gaze_to_angles(gaze) - MEAN_KAPPA_RAD)
    beside = np.linalg.norm(np.cross(sight, wanted), axis=-1)
    return np.asarray(np.arctan2(beside, (sight * wanted).sum(axis=-1)))


def cyclopean_line_of_sight_rad(gaze_in_space_rad: Float[ndarray, "T 2 2"]) -> Float[ndarray, "T 2"]:
    """Cyclopean line of sight: the mean of both optical axes minus the mean kappa."""
    return np.asarray(gaze_in_space_rad.mean(axis=1) - MEAN_KAPPA_RAD.mean(axis=0))


def target_direction_rad(head: Float[ndarray, "T 3"], targets: Float[ndarray, "T 4"]) -> Float[ndarray, "T 2"]:
    """Direction in space to a target in world coordinates from between the eyes of a turned head."""
    moved = BETWEEN_EYES_M - np.einsum("tij,j->ti", rotation.rotvec_to_matrix(head), BETWEEN_EYES_M)
    seen = targets[:, :3] + targets[:, 3:] * moved
    return rotation.direction_to_angles(seen / np.linalg.norm(seen, axis=-1, keepdims=True))


def _sight_rad(
    head: Float[ndarray, "T 3"], targets: Float[ndarray, "T 4"], frame: CoordinateFrame
) -> Float[ndarray, "T 2 2"]:
    """(yaw, pitch) in the head of the line of sight of each eye to a target."""
    head = head if frame == "world" else np.zeros_like(head)
    return aim_eyes(targets, BETWEEN_EYES_M + EYES_M, head, np.broadcast_to(-BETWEEN_EYES_M, head.shape))
