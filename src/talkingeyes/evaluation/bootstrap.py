"""Estimates with intervals: seeded percentile bootstrap over clips, over speakers, and over seeds of training.

Sounds of one speaker are alike, so an interval for new people is one over speakers (a cluster bootstrap: speakers are
resampled, each with all of its sounds). Rows are compared on the same resamples.

Over several seeds of training and sampling, a metric has its mean, the interval of the mean over clips, and the range
of the seeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings

Statistic = Callable[[ndarray], float]  # function of clip indices, which may repeat


class BootstrapSettings(Settings):
    """Settings of the bootstrap."""

    n_resamples: Annotated[int, Field(ge=20)]  # number of resamples of the clips
    confidence_level: Annotated[float, Field(gt=0, lt=1)]  # fraction of resamples inside the interval
    seed: int


@dataclass(frozen=True)
class Estimate:
    """A value with its interval."""

    value: float
    low: float
    high: float


def bootstrap(statistic: Statistic, count: int, settings: BootstrapSettings) -> Estimate:
    """Evaluate a statistic on all `count` clips, with its interval over clips resampled with replacement.

    `statistic` takes clip indices, which may repeat. The same seed and count give the same resamples for every
    statistic, so that rows of a table are compared on the same resamples.
    """
    values = np.array([statistic(indices) for indices in resample_indices(count, settings)])
    return Estimate(float(statistic(np.arange(count))), *percentile_interval(values, settings))


def resample_indices(count: int, settings: BootstrapSettings) -> Int[ndarray, "D N"]:
    """Clip indices sampled with replacement, one row per resample."""
    rng = np.random.default_rng([settings.seed, count])
    return rng.integers(count, size=(settings.n_resamples, count))


def percentile_interval(values: Float[ndarray, " D"], settings: BootstrapSettings) -> tuple[float, float]:
    """Lower and upper limit of the interval of the resampled values; NaN is ignored."""
    tail = (1 - settings.confidence_level) / 2
    low, high = np.nanquantile(values, [tail, 1 - tail])
    return float(low), float(high)


def mean_statistic(values: Float[ndarray, " N"]) -> Statistic:
    """Mean over clips."""
    return lambda clips: float(values[clips].mean())


def ratio_statistic(values: Float[ndarray, " N"], reference: Float[ndarray, " N"]) -> Statistic:
    """Ratio of two means over the same clips."""
    return lambda clips: float(values[clips].sum() / reference[clips].sum())


def quantile_statistic(groups: Sequence[Float[ndarray, " _"]], quantile: float) -> Statistic:
    """High quantile of the pooled frames of the clips: the least value that `quantile` of the frames do not exceed.

    Frames are counted from the top, only as deep as resamples need, which is ten times as fast.
    """
    sizes = np.array([len(group) for group in groups])
    pooled = np.concatenate(groups)
    order = np.argsort(-pooled, kind="stable")
    values, owner = pooled[order], np.repeat(np.arange(len(groups)), sizes)[order]
    reach = min(len(values), int(5 * (1 - quantile) * len(values)) + 1)

    def statistic(clips: ndarray) -> float:
        times = np.bincount(clips, minlength=len(groups))
        above = math.floor((1 - quantile) * int(times @ sizes) + 1e-9)
        for top in (reach, len(values)):
            weight = np.cumsum(times[owner[:top]])
            if weight[-1] > above:
                break
        return float(values[np.searchsorted(weight, above, side="right")])

    return statistic


@dataclass(frozen=True)
class SoundStatistic:
    """A statistic of sounds (by their indices), and the speaker of each sound."""

    statistic: Statistic
    speakers: tuple[str, ...]


@dataclass(frozen=True)
class TableEstimate(Estimate):
    """A value with its interval over sounds (`low`, `high`) and its interval over speakers."""

    speakers_low: float
    speakers_high: float


def ratio_of_known(
    values: Float[ndarray, " N"], reference: Float[ndarray, " N"], speakers: Sequence[str]
) -> SoundStatistic:
    """Ratio of the means of two metrics of N sounds, over the sounds with both values; NaN where a resample has
    none."""
    known = ~np.isnan(values + reference)
    above, below = np.where(known, values, 0.0), np.where(known, reference, 0.0)

    def statistic(sounds: ndarray) -> float:
        total = below[sounds].sum()
        return float(above[sounds].sum() / total) if total else float("nan")

    return SoundStatistic(statistic, tuple(speakers))


def mean_of_known(values: Float[ndarray, " N"], speakers: Sequence[str]) -> SoundStatistic:
    """Mean of a metric of N sounds; sounds without a value (NaN) are left out."""
    return ratio_of_known(values, np.where(np.isnan(values), np.nan, 1.0), speakers)


def estimate(of: SoundStatistic, settings: BootstrapSettings) -> TableEstimate:
    """The value over all sounds, with both intervals."""
    sounds = bootstrap(of.statistic, len(of.speakers), settings)
    values = np.array([of.statistic(chosen) for chosen in resample_speakers(of.speakers, settings)])
    return TableEstimate(sounds.value, sounds.low, sounds.high, *percentile_interval(values, settings))


def difference(
    higher: SoundStatistic, lower: SoundStatistic, settings: BootstrapSettings, factor: float = 1.0
) -> TableEstimate:
    """`factor` times `higher`, minus `lower`, on the same sounds."""
    assert higher.speakers == lower.speakers, "rows of a table should be evaluated on the same sounds"

    def statistic(sounds: ndarray) -> float:
        return factor * higher.statistic(sounds) - lower.statistic(sounds)

    return estimate(SoundStatistic(statistic, higher.speakers), settings)


@lru_cache(maxsize=8)
def resample_speakers(speakers: tuple[str, ...], settings: BootstrapSettings) -> tuple[Int[ndarray, " _"], ...]:
    """Resamples of speakers with replacement, each as the indices of all sounds of its speakers."""
    names = np.array(speakers)
    sounds_of = [np.flatnonzero(names == name) for name in sorted(set(speakers))]
    return tuple(
        np.concatenate([sounds_of[index] for index in chosen]) for chosen in resample_indices(len(sounds_of), settings)
    )


@dataclass(frozen=True)
class ClipStatistic:
    """A statistic of clips, and the number of clips on which it is defined."""

    statistic: Statistic
    count: int

    def __call__(self, clips: ndarray) -> float:
        return self.statistic(clips)


@dataclass(frozen=True)
class MultiSeedEstimate(Estimate):
    """An estimate with its range over seeds."""

    seed_min: float
    seed_max: float


def nanmean_statistic(values: Float[ndarray, " N"]) -> ClipStatistic:
    """Mean over the clips with a value; NaN is left out."""
    known = values[~np.isnan(values)]
    return ClipStatistic(mean_statistic(known), len(known))


def estimate_over_seeds(by_seed: Sequence[ClipStatistic], settings: BootstrapSettings) -> MultiSeedEstimate:
    """Mean of a statistic over seeds, its interval over clips, and its range over seeds.

    Each resample averages the seeds on the same clips; seeds with another number of clips than the first are left out.
    """
    count = by_seed[0].count
    seeds = [each for each in by_seed if each.count == count]
    found = bootstrap(lambda clips: float(np.mean([each(clips) for each in seeds])), count, settings)
    values = [each(np.arange(count)) for each in seeds]
    return MultiSeedEstimate(found.value, found.low, found.high, min(values), max(values))


def estimates_over_seeds(
    by_seed: Sequence[Mapping[str, ClipStatistic]], settings: BootstrapSettings
) -> dict[str, MultiSeedEstimate]:
    """Estimates of the statistics of the first seed, by name."""
    return {
        name: estimate_over_seeds([each[name] for each in by_seed if name in each], settings) for name in by_seed[0]
    }
