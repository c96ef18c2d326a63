"""First Wasserstein distance of one quantity (amplitude, interval, dwell, speed), in SDs of the reference.

W1 = integral |F(x) - G(x)| dx, where F and G are the distribution functions (Vallender 1974), divided by the standard
deviation of the reference, so that quantities of different units are comparable: 0 is the same distribution, 0.1 is
close, 1 is off by a whole SD. On the circle (directions) W1 = min over a of integral |F - G - a| (Rabin, Delon &
Gousseau 2011), in radians: a distribution spread around the circle has no meaningful SD to divide by.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import Statistic


def wasserstein(values: Float[ndarray, " N"], reference: Float[ndarray, " M"]) -> float:
    """W1 in SDs of the reference; NaN if either set is empty or the reference does not vary."""
    return wasserstein_statistic([values], reference)(np.zeros(1, dtype=int))


def wasserstein_statistic(groups: Sequence[Float[ndarray, " _"]], reference: Float[ndarray, " M"]) -> Statistic:
    """W1 of the pooled values of resampled clips (one group per clip), as a bootstrap statistic.

    Values are sorted once, so that each resample costs one pass.
    """
    pooled = np.concatenate([*groups, np.zeros(0)])
    owner = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    spread = float(reference.std()) if len(reference) else 0.0
    places = np.concatenate([pooled, reference])
    order = np.argsort(places, kind="stable")
    gaps = np.diff(places[order])
    ours = order < len(pooled)
    owners = owner[order[ours]]
    expected = np.cumsum(~ours)[:-1] / max(len(reference), 1)

    def statistic(clips: ndarray) -> float:
        times = np.bincount(clips, minlength=len(groups))[owners]
        total = times.sum()
        if not total or not spread:
            return float("nan")
        weight = np.zeros(len(order))
        weight[ours] = times / total
        return float(np.abs(np.cumsum(weight)[:-1] - expected) @ gaps / spread)

    return statistic


def histogram(values: Float[ndarray, " N"], edges: Float[ndarray, " K1"]) -> Float[ndarray, " K"]:
    """Counts between ascending edges; values beyond them count in the first and last bin."""
    return np.histogram(np.clip(values, edges[0], edges[-1]), bins=edges)[0].astype(float)


def wasserstein_binned(
    counts: Float[ndarray, " K"], reference: Float[ndarray, " K"], edges: Float[ndarray, " K1"]
) -> float:
    """W1 of two histograms in SDs of the reference.

    For quantities with one value per frame: memory does not grow with the number of frames.
    """
    if not counts.sum() or not reference.sum():
        return float("nan")
    middles, share = (edges[:-1] + edges[1:]) / 2, reference / reference.sum()
    spread = np.sqrt(share @ np.square(middles - share @ middles))
    between = np.cumsum(counts / counts.sum() - share)[:-1]
    return float(np.abs(between) @ np.diff(middles) / spread) if spread else float("nan")


def circular_wasserstein(values_rad: Float[ndarray, " N"], reference_rad: Float[ndarray, " M"]) -> float:
    """W1 of two sets of directions on the circle, in radians: at most pi. NaN if either is empty."""
    if not len(values_rad) or not len(reference_rad):
        return float("nan")
    places = np.concatenate([values_rad, reference_rad]) % (2 * np.pi)
    weight = np.concatenate(
        [np.full(len(values_rad), 1 / len(values_rad)), np.full(len(reference_rad), -1 / len(reference_rad))]
    )
    order = np.argsort(places, kind="stable")
    gaps = np.diff(places[order], append=places[order[0]] + 2 * np.pi)
    height = np.cumsum(weight[order])
    ranks = np.argsort(height, kind="stable")
    middle = height[ranks[np.searchsorted(np.cumsum(gaps[ranks]), np.pi)]]
    return float(np.abs(height - middle) @ gaps)
