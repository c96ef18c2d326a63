"""Eye-head coordination in gaze shifts, and the shape of head movements.

The head contributes linearly beyond a threshold of eccentricity (Stahl 1999; Freedman & Sparks 1997), starts about 30
ms after the eye, and moves with minimum jerk. The vestibulo-ocular reflex needs no separate model: gaze is generated in
space and the eye rotation is head^-1 gaze (as in `rotation.eye_in_head`), clamped to the oculomotor range in
conversation. Times are in seconds, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMovement
from talkingeyes.physiology.vergence import lines_of_sight, optical_axes_rad

# 30 degrees to the sides and down, 20 up (Guitton & Volle 1987; Stahl 1999), minus half a degree.
YAW_LIMIT_RAD = np.radians(29.5)
PITCH_LIMITS_RAD = (np.radians(-29.5), np.radians(19.5))
SMALLEST_LIMIT_RAD = min(YAW_LIMIT_RAD, *np.abs(PITCH_LIMITS_RAD))
ONSET_LAG_S = (0.030, 0.040)
ONSET_LAG_LIMITS_S = (-0.100, 0.150)


def head_contribution(
    eccentricity_rad: Float[ndarray, "*N 2"], threshold_rad: float, gain: float
) -> Float[ndarray, "*N 2"]:
    """Head rotation (yaw, pitch) towards a target at an eccentricity from the current head direction."""
    size = np.linalg.norm(eccentricity_rad, axis=-1, keepdims=True)
    share = gain * np.maximum(0.0, size - threshold_rad) / np.maximum(size, 1e-12)
    return np.asarray(share * eccentricity_rad)


def head_duration_s(amplitude_rad: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """Duration of a head movement of this amplitude: 250 ms + 12 ms per degree."""
    return np.asarray(0.250 + 0.012 * np.degrees(amplitude_rad))


def sample_onset_lag_s(rng: np.random.Generator) -> float:
    """Sample the delay of the head after the eye (negative: the head starts first)."""
    return float(np.clip(rng.normal(*ONSET_LAG_S), *ONSET_LAG_LIMITS_S))


def minimum_jerk(phase: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """Completed fraction of a minimum-jerk movement at `phase` (clipped to 0..1)."""
    x = np.clip(phase, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))


def head_path(moves: Sequence[HeadMovement], times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 3"]:
    """Sum of the head movements as a rotation vector (the angles are small enough to add)."""
    total = np.zeros((len(times_s), 3))
    for move in moves:
        total += minimum_jerk((times_s - move.onset_s) / move.duration_s)[:, None] * np.array(move.delta_rad)
    return total


def eye_rotations(
    head: Float[ndarray, "T 3"],
    gaze_in_space_rad: Float[ndarray, "T 2"],
    vergence: Float[ndarray, " T"],
    kappa_rad: Float[ndarray, "2 2"],
    blink_rad: Float[ndarray, "T 2 2"],
) -> Float[ndarray, "T 2 3"]:
    """Eye-in-head rotations without torsion and within range, as directions of the optical axes.

    The lines of sight meet in direction `gaze_in_space_rad` at the angle `vergence`; rotation by blinks is added.
    """
    straight = np.einsum("tji,tj->ti", rotation.rotvec_to_matrix(head), rotation.angles_to_direction(gaze_in_space_rad))
    axes = optical_axes_rad(lines_of_sight(straight, vergence), kappa_rad) + blink_rad
    return rotation.angles_to_gaze(clamp_angles(axes))


def clamp_to_eye_range(gaze: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    """Clamp eye rotation vectors to the oculomotor range; those within are unchanged."""
    far = np.einsum("...i,...i->...", gaze, gaze) > SMALLEST_LIMIT_RAD**2
    if not far.any():
        return gaze
    held = gaze.copy()
    held[far] = rotation.angles_to_gaze(clamp_angles(rotation.gaze_to_angles(gaze[far])))
    return held


def clamp_angles(axes_rad: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 2"]:
    """Clamp yaw and pitch of eyes in the head to the oculomotor range."""
    least, most = np.transpose([(-YAW_LIMIT_RAD, YAW_LIMIT_RAD), PITCH_LIMITS_RAD])
    return np.asarray(axes_rad.clip(least, most))
