"""Labelled postures of an eye as in the Eyelid paper, generated on a head with anatomical lids.

Section 4.1 of the paper: nine extreme gazes, closed lids, and 24 postures of free speech, with hand-labelled curves.
Here the curves are those of a head's lids (`anatomy`), gaze is read from the labelled iris contour as in the paper, and
labels are noisy. `posture_grid` is the same without noise, for building a head.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.head.eyelid.anatomy import JITTER_RAD, EyelidParameters, iris_contour, lid_points
from talkingeyes.head.eyelid.curves import fit_circle
from talkingeyes.head.eyelid.model import POINTS, LabelledPostures
from talkingeyes.head.eyelid.region import EyelidRegion

HELD_RAD = np.radians([[yaw, pitch] for pitch in (18.0, 0.0, -28.0) for yaw in (-30.0, 0.0, 30.0)])
CLOSED_POSTURES, SPEECH_POSTURES = 1, 24
FREE_SPREAD_RAD, FREE_LIMITS_RAD = np.radians([9.0, 7.0]), np.radians([[-30.0, -25.0], [30.0, 18.0]])
BLINKS, REST_SPREAD = 0.15, 0.06  # fraction of speech in blinks (26 per minute), spread of the lid's rest
LABEL_NOISE_M = 0.0003  # error of a hand-labelled curve
IRIS_POINTS = 16
HELD_OUT_DISTANCE_RAD = np.radians(2.0)

Random = np.random.Generator
LidCurveFunction = Callable[
    [ndarray, ndarray, Random], ndarray
]  # angles (N, 2) and closures (N,) to curves (N, P, 3) of a region


def anatomical_lid_curves(region: EyelidRegion, eyelid_parameters: EyelidParameters) -> LidCurveFunction:
    """Lid curves according to `anatomy`, with the variation of a lid at constant gaze in each posture."""

    def curves(angles_rad: Float[ndarray, "N 2"], lid: Float[ndarray, " N"], rng: Random) -> Float[ndarray, "N P 3"]:
        jitter = rng.normal(0.0, JITTER_RAD, len(lid))
        return lid_points(region, angles_rad, lid, eyelid_parameters, jitter)[:, :POINTS]

    return curves


def paper_postures(lid_curves: LidCurveFunction, rng: Random) -> LabelledPostures:
    """The paper's training set: 9 held gazes, closed lids, 24 postures of speech."""
    free, lid = speech_postures(SPEECH_POSTURES, rng)
    angles = np.concatenate([HELD_RAD, np.zeros((CLOSED_POSTURES, 2)), free])
    closures = np.concatenate([np.zeros(len(HELD_RAD)), np.ones(CLOSED_POSTURES), lid])
    place = np.arange(len(angles))
    held, shut = place < len(HELD_RAD), (place >= len(HELD_RAD)) & (place < len(HELD_RAD) + CLOSED_POSTURES)
    return LabelledPostures(*_label(lid_curves, angles, closures, rng), held=held, shut=shut)


def held_out_postures(
    lid_curves: LidCurveFunction, training_angles_rad: Float[ndarray, "K 2"], count: int, rng: Random
) -> LabelledPostures:
    """Postures of speech with gaze at least HELD_OUT_DISTANCE_RAD from every gaze in the training set."""
    angles, lid = speech_postures(20 * count, rng)
    away = np.linalg.norm(angles[:, None] - training_angles_rad, axis=-1).min(axis=1) >= HELD_OUT_DISTANCE_RAD
    rows = np.flatnonzero(away)[:count]
    none = np.zeros(len(rows), bool)
    return LabelledPostures(*_label(lid_curves, angles[rows], lid[rows], rng), held=none, shut=none)


def posture_grid(region: EyelidRegion, eyelid_parameters: EyelidParameters) -> LabelledPostures:
    """A grid of gazes with open lids, and closures at gaze straight ahead, noiseless, with all points of the region.

    Used to build a head. Half-closed lids follow gaze less and would bias the first stage, so they appear at one gaze
    only.
    """
    yaw, pitch = np.meshgrid(np.radians(np.linspace(-30, 30, 5)), np.radians(np.linspace(-25, 20, 10)), indexing="ij")
    gazes, closing = np.stack([yaw.ravel(), pitch.ravel()], axis=-1), np.linspace(0.25, 1, 4)
    angles = np.concatenate([gazes, np.zeros((len(closing), 2))])
    closures = np.concatenate([np.zeros(len(gazes)), closing])
    points = lid_points(region, angles, closures, eyelid_parameters, np.zeros(len(angles)))
    return LabelledPostures(angles, points, held=closures == 0.0, shut=closures == 1.0)


def speech_postures(count: int, rng: Random) -> tuple[Float[ndarray, "N 2"], Float[ndarray, " N"]]:
    """Gaze angles and closures of free speech, some of them in blinks."""
    angles = np.clip(rng.normal(0.0, FREE_SPREAD_RAD, (count, 2)), *FREE_LIMITS_RAD)
    rest = np.clip(rng.normal(0.0, REST_SPREAD, count), -0.2, 0.3)
    return angles, np.where(rng.random(count) < BLINKS, rng.uniform(0.3, 1.0, count), rest)


def _label(
    lid_curves: LidCurveFunction, angles_rad: Float[ndarray, "N 2"], lid: Float[ndarray, " N"], rng: Random
) -> tuple[Float[ndarray, "N 2"], Float[ndarray, "N P 3"]]:
    exact = lid_curves(angles_rad, lid, rng)
    curves = exact + rng.normal(0.0, LABEL_NOISE_M / np.sqrt(3), exact.shape)
    contours = iris_contour(angles_rad, IRIS_POINTS, rng, LABEL_NOISE_M / np.sqrt(3))
    return np.stack([fit_circle(contour).angles_rad for contour in contours]), curves
