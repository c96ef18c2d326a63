"""Metrics of one clip and of one row of Table III: distances, Corr. and dynamics, with intervals.

L2, Diversity and Corr. compare with fitted motion; dynamics compare with the true motion, or with fitted motion in a
corpus without truth. The parts are `gaze` (eye-in-head), `gaze_in_space` and `head`. The mean pose has the best L2 and
a conditional mean the best Corr., so each metric is reported with its reference over the same clips.

L2 and Diversity (section V-B.3) are means over frames of the Euclidean norm over all six radians of gaze (three of the
head), not the root of a mean of squares. The paper's ratio of Random to Mean, 1.40, is close to the square root of 2
and supports this reading. A constant near the mean has the best L2 and noise the best Diversity, so neither should be
read alone.
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
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    SoundStatistic,
    TableEstimate,
    estimate,
    mean_statistic,
    quantile_statistic,
    ratio_statistic,
)
from talkingeyes.evaluation.measures.corr import CRITICS, CorrScores


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

    speaker: str
    samples: Samples
    includes_reference: bool
    fitted: Samples
    truth: Samples | None
    valid: Bool[ndarray, " T"]  # frames of the first fitted take with observations


@dataclass(frozen=True)
class ClipMetrics:
    """Metrics of one part of one clip; NaN where a metric needs more takes. Speeds in degrees per second."""

    speaker: str
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
            speaker=case.speaker,
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


def summarise(part: str, clips: Sequence[ClipMetrics], settings: BootstrapSettings) -> dict[str, TableEstimate]:
    """Metrics of a part over clips, with intervals; a metric that no clip defines is left out.

    `diversity_multi_take` is over the sounds with several takes, and `diversity_ratio` divides it by the diversity of
    the truth on these sounds (`diversity_ratio_fitted`: of the fitted motion). `corr_minus_fitted` subtracts the Corr.
    of the fitted motion, `corr_minus_shuffled` that of the same motion under other sounds of the speaker
    (`corr_shuffled`).
    """
    found = {**(_distances(clips) if part != "gaze_in_space" else {}), **_correlations(clips), **_dynamics(clips)}
    return {name: estimate(each, settings) for name, each in found.items() if each.speakers}


def _distances(clips: Sequence[ClipMetrics]) -> dict[str, SoundStatistic]:
    own, fitted, truth = (_column(clips, f"diversity{of}") for of in ("", "_fitted", "_truth"))
    several = [clip for clip, known in zip(clips, ~np.isnan(own + fitted + truth), strict=True) if known]
    return {
        "diversity": _mean(clips, own),
        "diversity_multi_take": _mean(several, _column(several, "diversity")),
        "diversity_ratio": _ratio(several, _column(several, "diversity"), _column(several, "diversity_truth")),
        "diversity_ratio_fitted": _ratio(several, _column(several, "diversity"), _column(several, "diversity_fitted")),
        "l2": _mean(clips, _column(clips, "l2")),
    }


def _correlations(clips: Sequence[ClipMetrics]) -> dict[str, SoundStatistic]:
    corr = _column(clips, "corr")
    shuffled = _column(clips, "corr_shuffled")
    return {
        "corr": _mean(clips, corr),
        "corr_minus_fitted": _mean(clips, corr - _column(clips, "corr_fitted")),
        "corr_shuffled": _mean(clips, shuffled),
        "corr_minus_shuffled": _mean(clips, corr - shuffled),
    }


def _dynamics(clips: Sequence[ClipMetrics]) -> dict[str, SoundStatistic]:
    mean, of_truth = (np.array([each.mean() for each in speeds]) for speeds in _speeds(clips))
    top, top_of_truth = (quantile_statistic(speeds, 0.99) for speeds in _speeds(clips))
    return {
        "speed": _mean(clips, mean),
        "speed_ratio": _ratio(clips, mean, of_truth),
        "speed_p99": SoundStatistic(top, _speakers(clips)),
        "speed_p99_ratio": SoundStatistic(
            lambda resampled: top(resampled) / top_of_truth(resampled), _speakers(clips) if of_truth.all() else ()
        ),
        "still_fraction": _mean(clips, np.array([still_fraction(clip.speed) for clip in clips])),
    }


def _speeds(clips: Sequence[ClipMetrics]) -> tuple[list[ndarray], list[ndarray]]:
    return [clip.speed for clip in clips], [clip.speed_truth for clip in clips]


def _column(clips: Sequence[ClipMetrics], name: str) -> Float[ndarray, " N"]:
    return np.array([getattr(clip, name) for clip in clips])


def _speakers(clips: Sequence[ClipMetrics]) -> tuple[str, ...]:
    return tuple(clip.speaker for clip in clips)


def _ratio(
    clips: Sequence[ClipMetrics], values: Float[ndarray, " N"], reference: Float[ndarray, " N"]
) -> SoundStatistic:
    """Ratio of means over clips; undefined if any reference value is zero."""
    return SoundStatistic(ratio_statistic(values, reference), _speakers(clips) if reference.all() else ())


def _mean(clips: Sequence[ClipMetrics], values: Float[ndarray, " N"]) -> SoundStatistic:
    known = ~np.isnan(values)
    return SoundStatistic(
        mean_statistic(values[known]), tuple(clip.speaker for clip, of in zip(clips, known, strict=True) if of)
    )


def distance(
    one: Float[ndarray, "... T C"], other: Float[ndarray, "... T C"], valid: Bool[ndarray, " T"] | None = None
) -> Float[ndarray, ...]:
    """Mean over valid frames of the norm of the difference, in radians. Leading axes are broadcast."""
    norm = np.linalg.norm(one - other, axis=-1)
    return np.asarray(norm.mean(axis=-1) if valid is None else norm[..., valid].mean(axis=-1))


def l2_error(
    samples: Float[ndarray, "S T C"], reference: Float[ndarray, ...], valid: Bool[ndarray, " T"] | None = None
) -> float:
    """L2 of one clip: mean distance of the samples to the reference motion, in radians."""
    return float(distance(samples, reference[None], valid).mean())


def diversity(samples: Float[ndarray, "S T C"], valid: Bool[ndarray, " T"] | None = None) -> float:
    """Diversity of one clip: mean distance between pairs of samples, in radians; NaN for a single sample."""
    if len(samples) < 2:
        return float("nan")
    return float(
        np.concatenate([distance(samples[i + 1 :], samples[i], valid) for i in range(len(samples) - 1)]).mean()
    )
