"""The figures of one clip, and of a row of Table III: distances, correlation and dynamics with intervals over clips.

L2, Diversity and Corr. compare with fitted motion, dynamics with the true motion (in a corpus without truth: the
fitted). The parts are `gaze` (eye-in-head), `space` (gaze in space) and `head`. The mean pose wins every L2 and a
conditional mean wins Corr., so every figure has its reference beside it, taken over the same clips.
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

    seed: int  # of the choice of mismatched clips
    mismatched_samples: Annotated[int, Field(gt=1)]  # samples of the row of mismatched motion
    benchmark_samples: Annotated[int, Field(ge=2)]  # samples of a sound that the gaze benchmark looks at
    bootstrap: BootstrapSettings


@dataclass(frozen=True)
class EvaluationCase:
    """One sound and what is compared under it; all of T frames.

    `own` says that the samples are real motions of this very sound, the first of them the one to compare with (rows
    truth and fitted): then only the others count in L2. `fitted` and `truth` hold the takes of the sound.
    """

    samples: Samples
    includes_reference: bool
    fitted: Samples
    truth: Samples | None
    valid: Bool[ndarray, " T"]  # frames of the first fitted take that were seen


@dataclass(frozen=True)
class ClipMetrics:
    """One part of one clip; NaN where a figure needs more takes than there are. Speeds in degrees a second."""

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
    """The figures of one clip, by part; `corr_scores` is what critics say of its samples and its fitted takes."""
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
    """What distances are taken of: 3 radians of the head, 6 of the eyes."""
    return samples.head if part == "head" else samples.gaze.reshape(*samples.gaze.shape[:2], 6)


def speed_deg_s(part: str, samples: Samples) -> Float[ndarray, "S F"]:
    """Speed of a part between frames."""
    if part == "head":
        return head_speed_deg_s(samples.head, samples.fps)
    if part == "gaze":
        return eye_speed_deg_s(samples.gaze, samples.fps)
    return gaze_in_space_speed_deg_s(samples.head, samples.gaze, samples.fps)


def first_sample(samples: Samples) -> Samples:
    """The first sample alone."""
    return Samples(samples.fps, samples.head[:1], samples.gaze[:1])


def crop_samples(samples: Samples, frames: int) -> Samples:
    """The first frames."""
    return Samples(samples.fps, samples.head[:, :frames], samples.gaze[:, :frames])


def summarise(part: str, clips: Sequence[ClipMetrics], settings: BootstrapSettings) -> dict[str, Estimate]:
    """The figures of a part over clips, with intervals; a figure that no clip allows is left out.

    `diversity_multi_take` is over the sounds with several takes alone, `diversity_ratio` to truth's own over the same
    sounds (`diversity_ratio_fitted`: to the fitted motion's own); `corr_minus_fitted` is to the fitted motion's own,
    `corr_minus_shuffled` to the same motion under other sounds of the speaker (`corr_shuffled`).
    """
    found = {**(_distances(clips) if part != "gaze_in_space" else {}), **_correlations(clips), **_dynamics(clips)}
    return {name: bootstrap(each.statistic, each.clips, settings) for name, each in found.items() if each.clips}


@dataclass(frozen=True)
class _ClipStatistic:
    """A statistic and the number of clips that it is defined on."""

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
            lambda drawn: top(drawn) / top_of_truth(drawn), len(clips) if of_truth.all() else 0
        ),
        "still_fraction": _mean(np.array([still_fraction(clip.speed) for clip in clips])),
    }


def _speeds(clips: Sequence[ClipMetrics]) -> tuple[list[ndarray], list[ndarray]]:
    return [clip.speed for clip in clips], [clip.speed_truth for clip in clips]


def _column(clips: Sequence[ClipMetrics], name: str) -> Float[ndarray, " N"]:
    return np.array([getattr(clip, name) for clip in clips])


def _ratio(values: Float[ndarray, " N"], reference: Float[ndarray, " N"]) -> _ClipStatistic:
    """Undefined where a reference does not move at all."""
    return _ClipStatistic(ratio_statistic(values, reference), len(values) if reference.all() else 0)


def _mean(values: Float[ndarray, " N"]) -> _ClipStatistic:
    known = values[~np.isnan(values)]
    return _ClipStatistic(mean_statistic(known), len(known))
