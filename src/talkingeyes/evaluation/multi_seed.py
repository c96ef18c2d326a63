"""Metrics over several seeds of training and sampling: mean, its interval over clips, and range over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, Statistic, bootstrap, mean_statistic


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
