"""Metrics of one clip and of one row of Table III: distances, Corr. and dynamics, with intervals over clips.

L2, Diversity and Corr. compare with fitted motion; dynamics compare with the true motion, or with fitted motion in a
corpus without truth. The parts are `gaze` (eye-in-head), `gaze_in_space` and `head`. The mean pose has the best L2 and
a conditional mean the best Corr., so each metric is reported with its reference over the same clips.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.kinematics import eye_speed_deg_s, gaze_in_space_speed_deg_s, head_speed_deg_s, still_fraction
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.benchmark.corr import CRITICS, CorrScores
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    Estimate,
    Statistic,
    bootstrap,
    mean_statistic,
    quantile_statistic,
    ratio_statistic,
)
from talkingeyes.evaluation.paper_metrics.l2_diversity import diversity, l2_error


class EvaluateSettings(Settings):
    """The section `evaluate`."""

    seed: int  # seed for the choice of mismatched clips
    mismatched_samples: Annotated[int, Field(gt=1)]  # samples per sound in the row of mismatched motion
    benchmark_samples: Annotated[int, Field(ge=2)]  # samples per sound in the gaze benchmark
    bootstrap: BootstrapSettings


@dataclass(frozen=True)
class EvaluationCase:
    """Samples and reference motions of one sound, all T frames long.

    `includes_reference`: the samples are real takes of this sound and the first is the reference itself (rows truth and
    fitted); L2 then excludes it. `fitted` and `truth` hold the takes of the sound.
    """

    samples: Samples
    includes_reference: bool
    fitted: Samples
    truth: Samples | None
    valid: Bool[ndarray, " T"]  # frames of the first fitted take with observations


@dataclass(frozen=True)
class ClipMetrics:
    """Metrics of one part of one clip; NaN where a metric needs more takes. Speeds in degrees per second."""

    diversity: float
    diversity_fitted: float
    diversity_truth: float
    l2: float
    corr: float
    corr_fitted: float
    corr_shuffled: float
    speed: Float[ndarray, " SF"]
    speed_truth: Float[ndarray, " F"]


def clip_metrics(
    case: EvaluationCase, corr_scores: Mapping[str, CorrScores], fitted_corr_scores: Mapping[str, CorrScores]
) -> dict[str, ClipMetrics]:
    """Metrics of one clip by part, from the Corr. of its samples and of its fitted takes (by critic)."""
    truth = case.truth or case.fitted
    found = {}
    for part, critic in CRITICS.items():
        samples, fitted = (rotation_vectors(part, each) for each in (case.samples, case.fitted))
        compared = samples[1:] if case.includes_reference else samples
        found[part] = ClipMetrics(
            diversity=diversity(samples),
            diversity_fitted=diversity(fitted),
            diversity_truth=diversity(rotation_vectors(part, truth)),
            l2=l2_error(compared, fitted[0], case.valid) if len(compared) else float("nan"),
            corr=float(corr_scores[critic].matched.mean()),
            corr_fitted=float(fitted_corr_scores[critic].matched.mean()),
            corr_shuffled=float(corr_scores[critic].others.mean()),
            speed=speed_deg_s(part, first_sample(case.samples) if case.includes_reference else case.samples)
            .ravel()
            .astype(np.float32),
            speed_truth=speed_deg_s(part, first_sample(truth)).ravel().astype(np.float32),
        )
    return found


def rotation_vectors(part: str, samples: Samples) -> Float[ndarray, "S T C"]:
    """Rotation vectors to compute distances on: 3 radians of the head, or 6 of both eyes."""
    return samples.head if part == "head" else samples.gaze.reshape(*samples.gaze.shape[:2], 6)


def speed_deg_s(part: str, samples: Samples) -> Float[ndarray, "S F"]:
    """Speed of a part between consecutive frames, in degrees per second."""
    if part == "head":
        return head_speed_deg_s(samples.head, samples.fps)
    if part == "gaze":
        return eye_speed_deg_s(samples.gaze, samples.fps)
    return gaze_in_space_speed_deg_s(samples.head, samples.gaze, samples.fps)


def first_sample(samples: Samples) -> Samples:
    """The first sample only."""
    return Samples(samples.fps, samples.head[:1], samples.gaze[:1])


def crop_samples(samples: Samples, frames: int) -> Samples:
    """The first `frames` frames of all samples."""
    return Samples(samples.fps, samples.head[:, :frames], samples.gaze[:, :frames])


def summarise(part: str, clips: Sequence[ClipMetrics], settings: BootstrapSettings) -> dict[str, Estimate]:
    """Metrics of a part over clips, with intervals; a metric that no clip defines is left out.

    `diversity_multi_take` is over the sounds with several takes, and `diversity_ratio` divides it by the diversity of
    the truth on these sounds (`diversity_ratio_fitted`: of the fitted motion). `corr_minus_fitted` subtracts the Corr.
    of the fitted motion, `corr_minus_shuffled` that of the same motion under other sounds of the speaker
    (`corr_shuffled`).
    """
    found = {**(_distances(clips) if part != "gaze_in_space" else {}), **_correlations(clips), **_dynamics(clips)}
    return {name: bootstrap(each.statistic, each.clips, settings) for name, each in found.items() if each.clips}


@dataclass(frozen=True)
class _ClipStatistic:
    """A statistic and the number of clips on which it is defined."""

    statistic: Statistic
    clips: int


def _distances(clips: Sequence[ClipMetrics]) -> dict[str, _ClipStatistic]:
    own, l2 = _column(clips, "diversity"), _column(clips, "l2")
    fitted, truth = _column(clips, "diversity_fitted"), _column(clips, "diversity_truth")
    multi = ~np.isnan(own + fitted + truth)
    return {
        "diversity": _mean(own),
        "diversity_multi_take": _mean(own[multi]),
        "diversity_ratio": _ratio(own[multi], truth[multi]),
        "diversity_ratio_fitted": _ratio(own[multi], fitted[multi]),
        "l2": _mean(l2),
    }


def _correlations(clips: Sequence[ClipMetrics]) -> dict[str, _ClipStatistic]:
    corr = _column(clips, "corr")
    shuffled = _column(clips, "corr_shuffled")
    return {
        "corr": _mean(corr),
        "corr_minus_fitted": _mean(corr - _column(clips, "corr_fitted")),
        "corr_shuffled": _mean(shuffled),
        "corr_minus_shuffled": _mean(corr - shuffled),
    }


def _dynamics(clips: Sequence[ClipMetrics]) -> dict[str, _ClipStatistic]:
    mean, of_truth = (np.array([each.mean() for each in speeds]) for speeds in _speeds(clips))
    top, top_of_truth = (quantile_statistic(speeds, 0.99) for speeds in _speeds(clips))
    return {
        "speed": _mean(mean),
        "speed_ratio": _ratio(mean, of_truth),
        "speed_p99": _ClipStatistic(top, len(clips)),
        "speed_p99_ratio": _ClipStatistic(
            lambda resampled: top(resampled) / top_of_truth(resampled), len(clips) if of_truth.all() else 0
        ),
        "still_fraction": _mean(np.array([still_fraction(clip.speed) for clip in clips])),
    }


def _speeds(clips: Sequence[ClipMetrics]) -> tuple[list[ndarray], list[ndarray]]:
    return [clip.speed for clip in clips], [clip.speed_truth for clip in clips]


def _column(clips: Sequence[ClipMetrics], name: str) -> Float[ndarray, " N"]:
    return np.array([getattr(clip, name) for clip in clips])


def _ratio(values: Float[ndarray, " N"], reference: Float[ndarray, " N"]) -> _ClipStatistic:
    """Ratio of means over clips; undefined if any reference value is zero."""
    return _ClipStatistic(ratio_statistic(values, reference), len(values) if reference.all() else 0)


def _mean(values: Float[ndarray, " N"]) -> _ClipStatistic:
    known = values[~np.isnan(values)]
    return _ClipStatistic(mean_statistic(known), len(known))
