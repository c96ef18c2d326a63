"""Every figure of a table with the interval that its clips allow: percentile bootstrap over clips, seeded."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings

Statistic = Callable[[ndarray], float]  # of clip indices, drawn with replacement


class BootstrapSettings(Settings):
    """How intervals are drawn."""

    n_resamples: Annotated[int, Field(ge=20)]  # resamples of the clips
    confidence_level: Annotated[float, Field(gt=0, lt=1)]  # share of resamples inside the interval
    seed: int


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval."""

    value: float
    low: float
    high: float


def bootstrap(statistic: Statistic, count: int, settings: BootstrapSettings) -> Estimate:
    """The statistic of all `count` clips, and its interval over clips drawn with replacement.

    `statistic` takes indices of clips, some of them several times. The same seed and count draw the same clips whatever
    is measured, so that rows of a table are compared on the same draws.
    """
    values = np.array([statistic(indices) for indices in resample_indices(count, settings)])
    return Estimate(float(statistic(np.arange(count))), *percentile_interval(values, settings))


def resample_indices(count: int, settings: BootstrapSettings) -> Int[ndarray, "D N"]:
    """Indices of clips drawn with replacement, a row a draw."""
    rng = np.random.default_rng([settings.seed, count])
    return rng.integers(count, size=(settings.n_resamples, count))


def percentile_interval(values: Float[ndarray, " D"], settings: BootstrapSettings) -> tuple[float, float]:
    """The limits that the values of the draws lie between; draws without a value do not count."""
    tail = (1 - settings.confidence_level) / 2
    low, high = np.nanquantile(values, [tail, 1 - tail])
    return float(low), float(high)


def mean_statistic(values: Float[ndarray, " N"]) -> Statistic:
    """The mean over clips."""
    return lambda clips: float(values[clips].mean())


def ratio_statistic(values: Float[ndarray, " N"], reference: Float[ndarray, " N"]) -> Statistic:
    """The ratio of two means over the same clips."""
    return lambda clips: float(values[clips].sum() / reference[clips].sum())


def quantile_statistic(groups: Sequence[Float[ndarray, " _"]], quantile: float) -> Statistic:
    """A high quantile of all frames of the clips, pooled: the smallest value that `quantile` of the frames do not
    exceed.

    Counted from the top, and only as far down as a resample ever reaches: that is ten times as fast.
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
