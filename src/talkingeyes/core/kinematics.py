"""Speeds of eyes, gaze and head, and the fraction of still frames.

Speeds are great-circle angles between successive frames times the frame rate, in degrees per second, so they do not
depend on the axes. A frame is still below 2.5 degrees per second: true gaze in space is still in about nine of ten
frames, true eye-in-head in a quarter, because the eyes counter-rotate the head.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core.rotation import angles_to_direction, gaze_in_space, rotvec_to_direction

STILL_THRESHOLD_DEG_S = 2.5


def angle_between_deg(one: Float[ndarray, "*N 3"], other: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N"]:
    """Angle between unit vectors in degrees, accurate also for tiny angles."""
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
    """Speed of the head between frames: the angle of the rotation from one to the next, including roll."""
    quaternion = Rotation.from_rotvec(head.reshape(-1, 3)).as_quat().reshape(*head.shape[:-1], 4)
    before, after = quaternion[..., :-1, :], quaternion[..., 1:, :]
    # Half the rotation is the angle between the quaternions; from their sum and difference it is accurate for tiny
    # angles.
    same = np.where((before * after).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    half = np.arctan2(np.linalg.norm(after - same * before, axis=-1), np.linalg.norm(after + same * before, axis=-1))
    return np.asarray(np.degrees(4 * half) * fps)


def still_fraction(speed_deg_s: Float[ndarray, "*N"]) -> float:
    """Fraction of frames that are still."""
    return float((speed_deg_s < STILL_THRESHOLD_DEG_S).mean())


def _speed_deg_s(direction: Float[ndarray, "*S T 2 3"], fps: float) -> Float[ndarray, "*S T-1"]:
    return np.asarray(angle_between_deg(direction[..., :-1, :, :], direction[..., 1:, :, :]).mean(axis=-1) * fps)
