"""Estimates with intervals: seeded percentile bootstrap over clips."""

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
