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

    def point_estimate(self) -> float:
        """Value over all clips."""
        return self.statistic(np.arange(self.count))


@dataclass(frozen=True)
class MultiSeedEstimate(Estimate):
    """An estimate with its range over seeds."""

    seed_min: float
    seed_max: float


def nanmean_statistic(values: Float[ndarray, " N"]) -> ClipStatistic:
    """Mean over the clips with a value; NaN is left out."""
    known = values[~np.isnan(values)]
    return ClipStatistic(mean_statistic(known), len(known))


@dataclass(frozen=True)
class MultiSeedStatistic:
    """The same statistic of the same clips under several seeds; each resample averages the seeds on the same clips."""

    by_seed: tuple[ClipStatistic, ...]

    @property
    def count(self) -> int:
        """Number of clips."""
        return self.by_seed[0].count

    def __call__(self, clips: ndarray) -> float:
        return float(np.mean([each(clips) for each in self.by_seed]))

    def estimate(self, settings: BootstrapSettings) -> MultiSeedEstimate:
        """Mean over seeds, its interval over clips, and the range over seeds."""
        found, values = bootstrap(self, self.count, settings), [each.point_estimate() for each in self.by_seed]
        return MultiSeedEstimate(found.value, found.low, found.high, min(values), max(values))


def combine_seeds(by_seed: Sequence[Mapping[str, ClipStatistic]]) -> dict[str, MultiSeedStatistic]:
    """Statistics by name, over the seeds with as many clips as the first seed."""
    return {
        name: MultiSeedStatistic(
            tuple(each[name] for each in by_seed if name in each and each[name].count == first.count)
        )
        for name, first in by_seed[0].items()
    }
