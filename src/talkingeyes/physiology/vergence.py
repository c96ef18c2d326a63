"""Binocular gaze: vergence towards the target distance, and the optical axis of each eye.

The eyes converge by atan(half the eye distance / target distance) each. People do so only partly (Malinov et al. 2000)
and slowly (some 200 ms), and every saccade causes a transient divergence, because the abducting eye is faster
(Collewijn, Erkelens & Steinman 1988). The pupil does not lie on the line of sight: the optical axis, which pupils, lids
and cameras follow, differs from the visual axis by kappa, a constant of each eye. Motion.gaze is the optical axis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.motion import Saccade, VergenceMovement

HALF_INTERPUPILLARY_M = 0.03145
VERGENCE_GAIN = 0.7
TIME_CONSTANT_S = 0.200
# Relative to a saccade's horizontal component: 10 degrees cause half a degree of divergence, limited to 3 degrees.
DIVERGENCE_SHARE, DIVERGENCE_LIMIT_RAD = 0.05, np.radians(3.0)
DIVERGENCE_STRETCH = 1.6  # divergence ends somewhat after the saccade


def vergence_rad(distance_m: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """Angle between the lines of sight for a target at a distance."""
    return np.asarray(VERGENCE_GAIN * 2.0 * np.arctan(HALF_INTERPUPILLARY_M / np.asarray(distance_m)))


def vergence_path(
    vergence_movements: Sequence[VergenceMovement], saccades: Sequence[Saccade], times_s: Float[ndarray, " T"]
) -> Float[ndarray, " T"]:
    """Angle between the lines of sight at ascending times; 0 without a target.

    Each target is approached exponentially from the vergence at its onset; the first target is already reached.
    """
    path = np.zeros(len(times_s))
    if vergence_movements:
        onset_s = np.array([each.onset_s for each in vergence_movements])
        target = vergence_rad(np.array([each.distance_m for each in vergence_movements]))
        start = target.copy()
        for index in range(1, len(target)):
            left = np.exp(-(onset_s[index] - onset_s[index - 1]) / TIME_CONSTANT_S)
            start[index] = target[index - 1] + (start[index - 1] - target[index - 1]) * left
        now = np.maximum(np.searchsorted(onset_s, times_s, side="right") - 1, 0)
        left = np.exp(-np.maximum(times_s - onset_s[now], 0.0) / TIME_CONSTANT_S)
        path = target[now] + (start - target)[now] * left
    return np.asarray(path - saccadic_divergence(saccades, times_s))


def saccadic_divergence(saccades: Sequence[Saccade], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """Transient divergence in saccades: a raised cosine over each saccade and shortly after."""
    if not saccades:
        return np.zeros(len(times_s))
    onset, duration, start, end = np.array(
        [(s.onset_s, s.duration_s, s.start_rad[0], s.end_rad[0]) for s in saccades]
    ).T
    size = np.minimum(DIVERGENCE_SHARE * np.abs(end - start), DIVERGENCE_LIMIT_RAD)
    now = np.maximum(np.searchsorted(onset, times_s, side="right") - 1, 0)
    phase = np.clip((times_s - onset[now]) / (DIVERGENCE_STRETCH * duration[now]), 0.0, 1.0)
    return np.asarray(size[now] * 0.5 * (1.0 - np.cos(2.0 * np.pi * phase)))


def lines_of_sight(one: Float[ndarray, "T 3"], vergence: Float[ndarray, " T"]) -> Float[ndarray, "T 2 3"]:
    """Unit vectors from the left and the right eye to a target in cyclopean direction `one`, in the head.

    `vergence` gives the target's distance as if it were straight ahead; negative values diverge.
    """
    aside = np.tan(vergence / 2.0)
    both = np.stack([one, one], axis=1)
    both[:, 0, 0] -= aside
    both[:, 1, 0] += aside
    return np.asarray(both / np.linalg.norm(both, axis=-1, keepdims=True))


def optical_axes_rad(sight: Float[ndarray, "T 2 3"], kappa_rad: Float[ndarray, "2 2"]) -> Float[ndarray, "T 2 2"]:
    """(yaw, pitch) of the optical axes for lines of sight; `kappa_rad` is added to both angles."""
    return np.asarray(rotation.direction_to_angles(sight) + kappa_rad)
