"""A figure under several seeds of training and sampling: their mean, its interval over clips, the range over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, Statistic, bootstrap, mean_statistic


@dataclass(frozen=True)
class ClipStatistic:
    """A statistic of clips, and the number of clips that it is defined on."""

    statistic: Statistic
    count: int

    def __call__(self, clips: ndarray) -> float:
        return self.statistic(clips)

    def point_estimate(self) -> float:
        """Its value over all clips."""
        return self.statistic(np.arange(self.count))


@dataclass(frozen=True)
class MultiSeedEstimate(Estimate):
    """An estimate with its range over seeds."""

    seed_min: float
    seed_max: float


def nanmean_statistic(values: Float[ndarray, " N"]) -> ClipStatistic:
    """The mean over the clips that have the figure (NaN: has none)."""
    known = values[~np.isnan(values)]
    return ClipStatistic(mean_statistic(known), len(known))


@dataclass(frozen=True)
class MultiSeedStatistic:
    """The same figure of the same clips under several seeds. Resampled, the seeds are averaged on the same draws."""

    by_seed: tuple[ClipStatistic, ...]

    @property
    def count(self) -> int:
        """Of the clips."""
        return self.by_seed[0].count

    def __call__(self, clips: ndarray) -> float:
        return float(np.mean([each(clips) for each in self.by_seed]))

    def estimate(self, settings: BootstrapSettings) -> MultiSeedEstimate:
        """The mean of the seeds, its interval over clips, and the range."""
        found, values = bootstrap(self, self.count, settings), [each.point_estimate() for each in self.by_seed]
        return MultiSeedEstimate(found.value, found.low, found.high, min(values), max(values))


def combine_seeds(by_seed: Sequence[Mapping[str, ClipStatistic]]) -> dict[str, MultiSeedStatistic]:
    """Figures by name, of those seeds that know as many clips as the first does."""
    return {
        name: MultiSeedStatistic(
            tuple(each[name] for each in by_seed if name in each and each[name].count == first.count)
        )
        for name, first in by_seed[0].items()
    }
