"""What models and settings are chosen by, on val and in free running: Corr. and distances of the eyes' dynamics.

Distances are Wasserstein's between what was drawn and the truth, in standard deviations of the truth, so that speed
and amplitude weigh the same: of the speed of eye-in-head between frames and of the amplitudes of saccades of gaze in
space. A model without saccades is as far off as if all of its saccades were of no amplitude. The distance of places
stands beside them and not in their mean: of how far gaze is from straight ahead, which says whether it wanders off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.kinematics import eye_speed_deg_s
from talkingeyes.core.rotation import cyclopean_gaze, gaze_in_space
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.saccades import detect_saccades

# What a sweep may be told to look at.
SelectionMetric = Literal[
    "metrics_worse",
    "corr",
    "corr_gaze_in_space",
    "corr_head",
    "dynamics_distance",
    "eye_speed_distance",
    "saccade_amplitude_distance",
    "eccentricity_distance",
]


class ValidateSettings(Settings):
    """The section `validate`: samples for every val sound, and the seed that their seeds are made from."""

    seed: int
    samples: Annotated[int, Field(gt=1)]
    bootstrap: BootstrapSettings  # intervals of the gaze benchmark


@dataclass(frozen=True)
class MotionDynamics:
    """How eyes move in some motions: speeds between frames, amplitudes of saccades, angles to straight ahead."""

    eye_speed_deg_s: Float[ndarray, " F"]
    saccade_amplitude_deg: Float[ndarray, " N"]
    eccentricity_deg: Float[ndarray, " P"]


@dataclass(frozen=True)
class DynamicsDistances:
    """Of the distributions to the truth's, in its standard deviations."""

    eye_speed: float
    saccade_amplitude: float
    eccentricity: float

    @property
    def mean(self) -> float:
        """What is chosen by."""
        return (self.eye_speed + self.saccade_amplitude) / 2


def motion_dynamics(samples: Samples) -> MotionDynamics:
    """Of all samples of a sound together."""
    space = cyclopean_gaze(gaze_in_space(samples.head, samples.gaze))
    amplitudes = [detect_saccades(gaze, samples.fps).amplitude_deg for gaze in space]
    return MotionDynamics(
        eye_speed_deg_s(samples.gaze, samples.fps).ravel(),
        np.concatenate(amplitudes),
        np.degrees(np.linalg.norm(space, axis=-1)).ravel(),
    )


def dynamics_distances(sampled: Sequence[MotionDynamics], truth: Sequence[MotionDynamics]) -> DynamicsDistances:
    """Between all that was drawn and all of the truth."""
    return DynamicsDistances(
        distance([each.eye_speed_deg_s for each in sampled], [each.eye_speed_deg_s for each in truth]),
        distance([each.saccade_amplitude_deg for each in sampled], [each.saccade_amplitude_deg for each in truth]),
        distance([each.eccentricity_deg for each in sampled], [each.eccentricity_deg for each in truth]),
    )


def distance(sampled: Sequence[Float[ndarray, " _"]], truth: Sequence[Float[ndarray, " _"]]) -> float:
    """Wasserstein's distance in standard deviations of the truth."""
    from scipy.stats import wasserstein_distance

    one, other = np.concatenate(sampled), np.concatenate(truth)
    if not len(other):
        return 0.0 if not len(one) else float(one.mean())
    spread = max(float(other.std()), 1e-6)
    return float(wasserstein_distance(one if len(one) else np.zeros(1), other)) / spread
