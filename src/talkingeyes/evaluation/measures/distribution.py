"""Distances between distributions of windows: MMD, Frechet distance, precision and coverage, energy score.

Maximum mean discrepancy, with a permutation test (Gretton et al. 2012): MMD^2 = E k(x, x') + E k(y, y') - 2 E k(x, y),
unbiased, with a Gaussian kernel whose width is the median distance within the reference. Windows of one clip are
similar, so pairs within a clip are left out, and pairs with the same sound across paired sets as well. The permutation
test shuffles whole clips; otherwise it would find differences everywhere. The cost is quadratic in the number of
windows, so a fixed number of windows is sampled, evenly over clips.

Frechet distance between two Gaussians of features (Dowson & Landau 1982; Heusel et al. 2017).

d^2 = |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), over the features of windows. It is biased upwards by about the
number of features over the number of windows, so do not read it with fewer than ten windows per feature.

Precision is the fraction of samples inside the k-nearest-neighbour ball of any true window (Kynkaanniemi et al. 2019).
Coverage is the fraction of true windows whose ball holds a sample (Naeem et al. 2020). A constant near the mean has a
good precision and a low coverage, and noise the opposite.

The energy score is of samples against the observed motion (core/energy_score.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.distance import cdist

from talkingeyes.core.energy_score import energy_score
from talkingeyes.evaluation.bootstrap import Statistic


@dataclass(frozen=True)
class WindowFeatures:
    """Features of N windows, and the clip index of each."""

    features: Float[ndarray, "N D"]
    clip: Int[ndarray, " N"]


def sample_windows(groups: Sequence[Float[ndarray, "_ D"]], max_windows: int, seed: int) -> WindowFeatures:
    """Sample about `max_windows` windows, equally many per clip (one group each), from fewer clips if necessary."""
    rng = np.random.default_rng([seed, len(groups)])
    full = [index for index, group in enumerate(groups) if len(group)]
    kept = full if len(full) <= max_windows else sorted(rng.choice(full, max_windows, replace=False).tolist())
    each = max(1, max_windows // max(len(kept), 1))
    picked = [rng.permutation(len(groups[index]))[:each] for index in kept]
    clip = np.repeat(np.array(kept, dtype=int), [len(windows) for windows in picked])
    return WindowFeatures(
        np.concatenate([groups[index][windows] for index, windows in zip(kept, picked, strict=True)]), clip
    )


@dataclass(frozen=True)
class Kernels:
    """Kernel values within and between two sets, with masks of the pairs that count; 0 for pairs left out."""

    ours: Float[ndarray, "N N"]
    theirs: Float[ndarray, "M M"]
    across: Float[ndarray, "N M"]
    ours_count: Float[ndarray, "N N"]
    theirs_count: Float[ndarray, "M M"]
    across_count: Float[ndarray, "N M"]


def kernels(one: WindowFeatures, reference: WindowFeatures, paired: bool) -> Kernels:
    """Compute all kernel values; `paired`: clip i of both sets belongs to the same sound."""
    within = cdist(reference.features, reference.features)
    width = float(np.median(within[~np.eye(len(within), dtype=bool)]))
    scale = -0.5 / max(width, 1e-12) ** 2

    def kernel(distance: Float[ndarray, "A B"]) -> Float[ndarray, "A B"]:
        return np.asarray(np.exp(scale * np.square(distance)))

    ours_count = (one.clip[:, None] != one.clip).astype(float)
    theirs_count = (reference.clip[:, None] != reference.clip).astype(float)
    across_count = ((one.clip[:, None] != reference.clip) | (not paired)).astype(float)
    return Kernels(
        kernel(cdist(one.features, one.features)) * ours_count,
        kernel(within) * theirs_count,
        kernel(cdist(one.features, reference.features)) * across_count,
        ours_count,
        theirs_count,
        across_count,
    )


def mmd_statistic(one: WindowFeatures, reference: WindowFeatures, paired: bool = False) -> Statistic:
    """MMD^2 of resampled clips, as a bootstrap statistic.

    `paired`: the reference is resampled with the same clips; otherwise all of it is used.
    """
    found = kernels(one, reference, paired)

    def statistic(clips: ndarray) -> float:
        last = int(max(one.clip.max(), reference.clip.max(), clips.max())) + 1
        times = np.bincount(clips, minlength=last).astype(float)
        ours = times[one.clip]
        theirs = times[reference.clip] if paired else np.ones(len(reference.clip))
        return (
            _mean(ours, found.ours, found.ours_count, ours)
            + _mean(theirs, found.theirs, found.theirs_count, theirs)
            - 2 * _mean(ours, found.across, found.across_count, theirs)
        )

    return statistic


def permutation_p_value(one: WindowFeatures, reference: WindowFeatures, permutations: int, seed: int) -> float:
    """Permutation p-value over whole clips: (1 + permutations at least as far apart) / (1 + permutations)."""
    features = np.concatenate([one.features, reference.features])
    clip = np.concatenate([one.clip, one.clip.max() + 1 + reference.clip])
    names, owner = np.unique(clip, return_inverse=True)
    pooled = WindowFeatures(features, owner)
    found = kernels(pooled, pooled, paired=False)
    rng = np.random.default_rng(seed)
    mine = np.arange(len(names)) < len(np.unique(one.clip))
    values = []
    for turn in range(permutations + 1):
        dealt = mine if turn == 0 else rng.permutation(mine)
        ours, theirs = dealt[owner].astype(float), (~dealt[owner]).astype(float)
        values.append(
            _mean(ours, found.ours, found.ours_count, ours)
            + _mean(theirs, found.ours, found.ours_count, theirs)
            - 2 * _mean(ours, found.ours, found.ours_count, theirs)
        )
    return float((1 + (np.array(values[1:]) >= values[0]).sum()) / (1 + permutations))


def _mean(
    left: Float[ndarray, " A"], values: Float[ndarray, "A B"], count: Float[ndarray, "A B"], right: Float[ndarray, " B"]
) -> float:
    pairs = left @ count @ right
    return float(left @ values @ right / pairs) if pairs else float("nan")


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


@dataclass(frozen=True)
class PrecisionCoverage:
    """For each sampled window whether it lies in a ball of the truth; for each true window whether its ball has one."""

    precise: Float[ndarray, " N"]
    covered: Float[ndarray, " M"]


def precision_coverage(samples: WindowFeatures, reference: WindowFeatures, neighbours: int) -> PrecisionCoverage:
    """Compute precision and coverage of windows.

    The radius of a ball is the distance to the k-th neighbour among true windows of other clips, as windows of one clip
    are too similar. Truth compared with itself covers itself: compare it with other takes.
    """
    among = cdist(reference.features, reference.features)
    among[reference.clip[:, None] == reference.clip] = np.inf
    radius = np.partition(among, neighbours - 1, axis=1)[:, neighbours - 1]
    across = cdist(samples.features, reference.features)
    inside = across <= radius
    return PrecisionCoverage(inside.any(axis=1).astype(float), inside.any(axis=0).astype(float))


def windowed_energy_score(
    samples: Float[ndarray, "S T C"], observed: Float[ndarray, "T C"], frames: int
) -> Float[ndarray, " W"]:
    """Energy scores of consecutive windows as whole trajectories (root mean square over frames, radians).

    Each window is one vector, so frozen or jittering samples with the right spread are penalised as well.
    """
    count = observed.shape[0] // frames
    shape = (count, frames * observed.shape[1])
    ours = samples[:, : count * frames].reshape(len(samples), *shape)
    return np.asarray(energy_score(ours, observed[: count * frames].reshape(shape)) / np.sqrt(frames))
