"""Estimates of a table's cells and of differences of cells, with intervals over sounds and over speakers.

Sounds of one speaker are alike, so an interval for new people is one over speakers (a cluster bootstrap: speakers are
resampled, each with all of its sounds). Rows are compared on the same resamples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    Estimate,
    Statistic,
    bootstrap,
    percentile_interval,
    resample_indices,
)


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
