"""Metrics for model selection on free-running val samples: Corr. and distances of eye dynamics; Pareto fronts.

The distances are Wasserstein distances between samples and truth, in standard deviations of the truth, so that speed
and amplitude have the same weight. They compare the speed of eye-in-head between frames and the amplitude of saccades
of gaze in space. A model without saccades gets the distance of saccades of amplitude zero. The distance of eccentricity
(the angle between gaze in space and straight ahead) is reported separately and is not part of the mean: it shows
whether gaze drifts away.

Random motion has these distances as small as a model that follows its sound: choose by `tie` (Corr. less that under
other sounds of the speaker) as well, among models whose margins are those of the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.kinematics import (
    eye_speed_deg_s,
    gaze_in_space_speed_deg_s,
    head_speed_deg_s,
    still_fraction,
)
from talkingeyes.core.rotation import cyclopean_gaze, gaze_in_space
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.saccades import detect_saccades

# The metrics that a sweep can optimise.
SelectionMetric = Literal[
    "log_likelihood",
    "log_likelihood_head",
    "log_likelihood_gaze",
    "metrics_worse",
    "corr",
    "corr_gaze_in_space",
    "corr_head",
    "tie",
    "tie_gaze_in_space",
    "tie_head",
    "dynamics_distance",
    "motion_distance",
    "eye_speed_distance",
    "saccade_amplitude_distance",
    "eccentricity_distance",
]
MIN_RATIO = 0.01


class ValidateSettings(Settings):
    """Section `validate`: number of samples for each val sound, and the seed from which their seeds are derived."""

    seed: int
    samples: Annotated[int, Field(gt=1)]
    bootstrap: BootstrapSettings  # intervals of the gaze benchmark


@dataclass(frozen=True)
class MotionDynamics:
    """Dynamics of several motions: speeds between frames, amplitude of saccades, angle of gaze from straight ahead."""

    eye_speed_deg_s: Float[ndarray, " F"]
    gaze_in_space_speed_deg_s: Float[ndarray, " F"]
    head_speed_deg_s: Float[ndarray, " F"]
    saccade_amplitude_deg: Float[ndarray, " N"]
    eccentricity_deg: Float[ndarray, " P"]

    @classmethod
    def of(cls, samples: Samples) -> MotionDynamics:
        """Dynamics of all samples of a sound, pooled."""
        space = cyclopean_gaze(gaze_in_space(samples.head, samples.gaze))
        return cls(
            eye_speed_deg_s(samples.gaze, samples.fps).ravel(),
            gaze_in_space_speed_deg_s(samples.head, samples.gaze, samples.fps).ravel(),
            head_speed_deg_s(samples.head, samples.fps).ravel(),
            np.concatenate([detect_saccades(gaze, samples.fps).amplitude_deg for gaze in space]),
            np.degrees(np.linalg.norm(space, axis=-1)).ravel(),
        )

    @classmethod
    def pooled(cls, parts: Sequence[MotionDynamics]) -> MotionDynamics:
        """Dynamics of many sounds."""
        return cls(*(np.concatenate([getattr(each, field.name) for each in parts]) for field in fields(cls)))


def speed_margins(sampled: MotionDynamics, truth: MotionDynamics, fitted: MotionDynamics) -> dict[str, float]:
    """Speeds of samples relative to the truth's, and the time that gaze is at rest relative to fitted motion's and to
    the truth's."""
    top, top_of_truth = (float(np.quantile(each.eye_speed_deg_s, 0.99)) for each in (sampled, truth))
    rest, rest_of_fitted, rest_of_truth = (
        still_fraction(each.gaze_in_space_speed_deg_s) for each in (sampled, fitted, truth)
    )
    return {
        "eye_speed_ratio": float(sampled.eye_speed_deg_s.mean() / truth.eye_speed_deg_s.mean()),
        "eye_speed_p99_ratio": top / top_of_truth,
        "rest_ratio": rest / rest_of_fitted,
        "rest_ratio_truth": rest / rest_of_truth,
        "head_speed_ratio": float(sampled.head_speed_deg_s.mean() / truth.head_speed_deg_s.mean()),
    }


def motion_distance(ratios: Sequence[float]) -> float:
    """Distance of a model from the truth by ratios to it: the mean of their absolute logarithms, each at most that of
    a hundredth."""
    return float(np.abs(np.log(np.maximum(ratios, MIN_RATIO))).mean())


@dataclass(frozen=True)
class DynamicsDistances:
    """Wasserstein distances to the truth, in standard deviations of the truth."""

    eye_speed: float
    saccade_amplitude: float
    eccentricity: float

    @property
    def mean(self) -> float:
        """Mean of the distances of eye speed and saccade amplitude: the criterion of selection."""
        return (self.eye_speed + self.saccade_amplitude) / 2


def dynamics_distances(sampled: MotionDynamics, truth: MotionDynamics) -> DynamicsDistances:
    """Distances between all samples, pooled, and the whole truth."""
    return DynamicsDistances(
        distance(sampled.eye_speed_deg_s, truth.eye_speed_deg_s),
        distance(sampled.saccade_amplitude_deg, truth.saccade_amplitude_deg),
        distance(sampled.eccentricity_deg, truth.eccentricity_deg),
    )


def distance(one: Float[ndarray, " _"], other: Float[ndarray, " _"]) -> float:
    """Wasserstein distance in standard deviations of `other`, the truth.

    Without true values, the mean of the sampled values; without sampled values, the distance of zeros.
    """
    from scipy.stats import wasserstein_distance

    if not len(other):
        return 0.0 if not len(one) else float(one.mean())
    spread = max(float(other.std()), 1e-6)
    return float(wasserstein_distance(one if len(one) else np.zeros(1), other)) / spread


def plot_pareto_front(
    trials: Sequence[Sequence[float]], pareto_front: Sequence[Sequence[float]], names: Sequence[str], path: Path
) -> None:
    """Save a scatter plot of the two objectives: trials as grey dots, the Pareto front as an orange line with dots."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axis = figure.subplots()
    axis.scatter(*zip(*trials, strict=True), color="#8a8a8a", label=f"{len(trials)} trials")
    axis.plot(
        *zip(*sorted(map(tuple, pareto_front)), strict=True), "o-", color="#d95f02", label=f"front: {len(pareto_front)}"
    )
    axis.set_xlabel(f"{names[0]} on val")
    axis.set_ylabel(f"{names[1]} on val")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    figure.savefig(path, dpi=120, metadata={"Software": None})
