"""How fast eyes, gaze and head move, and how often they rest.

Speeds are great-circle angles between neighbouring frames times the frame rate, in degrees a second, so they are the
same in any axes. A frame is still below 2.5 degrees a second: true gaze in space rests in about nine frames of ten,
true eye-in-head in a quarter, because the eyes counter-rotate under the head (LEARNING.md, second trial).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.rotation import direction_of_angles, directions, gaze_in_space

STILL_DEG_S = 2.5


def angle_deg(one: Float[ndarray, "*N 3"], other: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N"]:
    """Angle between unit vectors in degrees, exact for tiny angles too."""
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * other).sum(axis=-1))))


def eye_speed_deg_s(gaze: Float[ndarray, "*S T 2 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    """Speed of eye-in-head between frames, mean of both eyes."""
    return _speed_deg_s(directions(gaze), fps)


def space_speed_deg_s(
    head: Float[ndarray, "*S T 3"], gaze: Float[ndarray, "*S T 2 3"], fps: float
) -> Float[ndarray, "*S T-1"]:
    """Speed of gaze in space, R(head) R(eye), between frames, mean of both eyes."""
    return _speed_deg_s(direction_of_angles(gaze_in_space(head, gaze)), fps)


def head_speed_deg_s(head: Float[ndarray, "*S T 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    """Speed of the head between frames: the angle of the rotation from one to the next, roll included."""
    before, after = head[..., :-1, :], head[..., 1:, :]
    turn = Rotation.from_rotvec(before.reshape(-1, 3)).inv() * Rotation.from_rotvec(after.reshape(-1, 3))
    return np.asarray(np.degrees(turn.magnitude()).reshape(before.shape[:-1]) * fps)


def still(speed_deg_s: Float[ndarray, "*N"]) -> float:
    """Share of frames that rest."""
    return float((speed_deg_s < STILL_DEG_S).mean())


def _speed_deg_s(unit: Float[ndarray, "*S T 2 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    return np.asarray(angle_deg(unit[..., :-1, :, :], unit[..., 1:, :, :]).mean(axis=-1) * fps)
