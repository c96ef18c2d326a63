"""Frechet distance between two Gaussians of features, and its noise floor (Dowson & Landau 1982; Heusel et al. 2017).

d^2 = |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), over the features of windows (encoder.py). It is biased upwards by
about the number of features over the number of windows. Read it only next to the distance between two halves of the
truth, and not at all with fewer than ten windows per feature. Moments are additive, so clips are resampled without
keeping their windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import Statistic

MIN_WINDOWS_PER_FEATURE = 10


@dataclass(frozen=True)
class Moments:
    """Count, sum and sum of squares of the features of each of C clips."""

    count: Float[ndarray, " C"]
    total: Float[ndarray, "C D"]
    square: Float[ndarray, "C D D"]

    @classmethod
    def of(cls, groups: Sequence[Float[ndarray, "_ D"]]) -> Moments:
        """Moments of the windows of each clip."""
        return cls(
            np.array([float(len(group)) for group in groups]),
            np.stack([group.sum(axis=0) for group in groups]),
            np.stack([group.T @ group for group in groups]),
        )

    @property
    def is_sufficient(self) -> bool:
        """Whether there are enough windows to estimate a covariance."""
        return bool(self.count.sum() >= MIN_WINDOWS_PER_FEATURE * self.total.shape[1])

    def gaussian(self, clips: Int[ndarray, " N"] | None = None) -> Gaussian:
        """Mean and covariance over clips; `clips` may repeat (bootstrap), by default all are used once."""
        times = np.ones(len(self.count)) if clips is None else np.bincount(clips, minlength=len(self.count))
        count = times @ self.count
        mean = times @ self.total / count
        square = np.tensordot(times, self.square, axes=1) / count
        return Gaussian(mean, square - np.outer(mean, mean))


@dataclass(frozen=True)
class Gaussian:
    """Mean and covariance of features."""

    mean: Float[ndarray, " D"]
    covariance: Float[ndarray, "D D"]


def frechet(one: Gaussian, other: Gaussian) -> float:
    """Squared Frechet distance; tr (S1 S2)^(1/2) from the eigenvalues of the symmetric S1^(1/2) S2 S1^(1/2)."""
    values, vectors = np.linalg.eigh(one.covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    cross = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ other.covariance @ root), 0)).sum()
    apart = np.square(one.mean - other.mean).sum()
    return float(max(0.0, apart + np.trace(one.covariance) + np.trace(other.covariance) - 2 * cross))


def frechet_statistic(moments: Moments, reference: Gaussian) -> Statistic:
    """Frechet distance of resampled clips from the reference, as a bootstrap statistic."""
    return lambda clips: frechet(moments.gaussian(clips), reference)


def split_half(moments: Moments, splits: int, seed: int) -> Float[ndarray, " R"]:
    """Noise floor: distances between two random halves of the clips of one set, `splits` times.

    Each half has half the windows, so this floor is above the bias of the whole set.
    """
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(splits):
        shuffled = rng.permutation(len(moments.count))
        halves = np.array_split(shuffled, 2)
        found.append(frechet(moments.gaussian(halves[0]), moments.gaussian(halves[1])))
    return np.array(found)
