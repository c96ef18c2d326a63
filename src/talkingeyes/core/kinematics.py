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

from talkingeyes.core.rotation import angles_to_direction, gaze_in_space, rotvec_to_direction

STILL_THRESHOLD_DEG_S = 2.5


def angle_between_deg(one: Float[ndarray, "*N 3"], other: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N"]:
    """Angle between unit vectors in degrees, exact for tiny angles too."""
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * other).sum(axis=-1))))


def eye_speed_deg_s(gaze: Float[ndarray, "*S T 2 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    """Speed of eye-in-head between frames, mean of both eyes."""
    return _speed_deg_s(rotvec_to_direction(gaze), fps)


def gaze_in_space_speed_deg_s(
    head: Float[ndarray, "*S T 3"], gaze: Float[ndarray, "*S T 2 3"], fps: float
) -> Float[ndarray, "*S T-1"]:
    """Speed of gaze in space, R(head) R(eye), between frames, mean of both eyes."""
    return _speed_deg_s(angles_to_direction(gaze_in_space(head, gaze)), fps)


def head_speed_deg_s(head: Float[ndarray, "*S T 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    """Speed of the head between frames: the angle of the rotation from one to the next, roll included."""
    quaternion = Rotation.from_rotvec(head.reshape(-1, 3)).as_quat().reshape(*head.shape[:-1], 4)
    before, after = quaternion[..., :-1, :], quaternion[..., 1:, :]
    # Half the turn is the angle between the quaternions; of their sum and difference it is exact for tiny turns too.
    same = np.where((before * after).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    half = np.arctan2(np.linalg.norm(after - same * before, axis=-1), np.linalg.norm(after + same * before, axis=-1))
    return np.asarray(np.degrees(4 * half) * fps)


def still_fraction(speed_deg_s: Float[ndarray, "*N"]) -> float:
    """Share of frames that rest."""
    return float((speed_deg_s < STILL_THRESHOLD_DEG_S).mean())


def _speed_deg_s(direction: Float[ndarray, "*S T 2 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    return np.asarray(angle_between_deg(direction[..., :-1, :, :], direction[..., 1:, :, :]).mean(axis=-1) * fps)
