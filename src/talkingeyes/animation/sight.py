"""From a place in metres to where eyes point, and back: which eye looks past it by how much.

Motion's gaze is the optical axis of each eye, which pupils follow; what falls on the target is the line of sight, kappa
away from it (docs/conventions.md). A model's gaze holds the mean person's kappa, so that one is used. Both eyes aim at
the target itself: its distance gives their vergence. Angles are (yaw, pitch), places metres from between the eyes of
the head at rest.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.physiology import eye_head
from talkingeyes.physiology.vergence import HALF_EYE_DISTANCE_M
from talkingeyes.synthesis.speakers import KAPPA_DEG, KAPPA_DOWN_DEG

EYES_M = np.array([[HALF_EYE_DISTANCE_M, 0.0, 0.0], [-HALF_EYE_DISTANCE_M, 0.0, 0.0]])
# From the joint about which the head turns to between the eyes, in the open head.
BETWEEN_EYES_M = np.array([0.0, 0.041374, 0.084397])
KAPPA_RAD = np.radians([[KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]], [-KAPPA_DEG[0], -KAPPA_DOWN_DEG[0]]])

Frame = Literal["world", "head"]


def toward_rad(head: Float[ndarray, "T 3"], places_m: Float[ndarray, "T 3"], frame: Frame) -> Float[ndarray, "T 2 2"]:
    """Where the optical axes of both eyes point in space when their lines of sight meet at a place, within reach."""
    turn = rotation.matrices(head)
    seen = _from_eyes(turn, places_m, frame)
    angles = rotation.angles_of_direction(seen / np.linalg.norm(seen, axis=-1, keepdims=True)) + KAPPA_RAD
    axes = rotation.direction_of_angles(eye_head.within_limits(angles))
    return rotation.angles_of_direction(np.einsum("tij,tej->tei", turn, axes))


def miss_rad(
    head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"], places_m: Float[ndarray, "T 3"], frame: Frame
) -> Float[ndarray, "T 2"]:
    """By what angle the line of sight of each eye goes past a place."""
    wanted = _from_eyes(rotation.matrices(head), places_m, frame)
    sight = rotation.direction_of_angles(rotation.angles_of_gaze(gaze) - KAPPA_RAD)
    beside = np.linalg.norm(np.cross(sight, wanted), axis=-1)
    return np.asarray(np.arctan2(beside, (sight * wanted).sum(axis=-1)))


def from_between_rad(space_rad: Float[ndarray, "T 2 2"]) -> Float[ndarray, "T 2"]:
    """The line of sight from between the eyes: the mean of both axes, less what kappa has in common."""
    return np.asarray(space_rad.mean(axis=1) - KAPPA_RAD.mean(axis=0))


def direction_rad(head: Float[ndarray, "T 3"], places_m: Float[ndarray, "T 3"]) -> Float[ndarray, "T 2"]:
    """In which direction in space a place of the world lies from between the eyes of a turned head."""
    seen = places_m + BETWEEN_EYES_M - np.einsum("tij,j->ti", rotation.matrices(head), BETWEEN_EYES_M)
    return rotation.angles_of_direction(seen / np.linalg.norm(seen, axis=-1, keepdims=True))


def _from_eyes(turn: Float[ndarray, "T 3 3"], places_m: Float[ndarray, "T 3"], frame: Frame) -> Float[ndarray, "T 2 3"]:
    """From each eye to a place, in the head's axes."""
    if frame == "world":
        places_m = np.einsum("tji,tj->ti", turn, places_m + BETWEEN_EYES_M) - BETWEEN_EYES_M
    return np.asarray(places_m[:, None] - EYES_M)
