"""Metrics on the features of windows from the fixed encoder: Frechet distance, MMD, precision and coverage.

The Frechet distance is computed from sums (count, sum and products of the features). MMD, precision and coverage
compare windows pairwise, on a fixed number of windows sampled evenly over the sounds (distribution.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import Statistic
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.distribution import (
    Gaussian,
    WindowFeatures,
    frechet,
    mmd_statistic,
    permutation_p_value,
    precision_coverage,
)
from talkingeyes.evaluation.measures.metric import HIGHER, LOWER, Extractor, Metric, Sums, Totals

# Maps head and gaze of S samples, and their frame rate, to the features of all windows, sample by sample.
Encoder = Callable[[ndarray, ndarray, float], ndarray]

MAX_FEATURES = 16  # length of the sums; an encoder with fewer features is padded with zeros, which change no distance
NEIGHBOURS = 3
PERMUTATIONS = 200
MIN_WINDOWS = 100
NEEDS = ("head", "gaze", "features")


def add_features(motions: Sequence[Behaviour], encoder: Encoder | None) -> list[Behaviour]:
    """Copy motions with the features of their windows; unchanged without an encoder, or without head or gaze."""
    if encoder is None:
        return list(motions)
    return [
        motion
        if motion.head is None or motion.gaze is None
        else replace(motion, features=encoder(motion.head[None], motion.gaze[None], motion.fps))
        for motion in motions
    ]


def gather_features(motions: Sequence[Behaviour]) -> Float[ndarray, "W D"]:
    """Features of all windows of all motions, shuffled, so that the first n are a random selection."""
    known = [motion.features for motion in motions if motion.features is not None]
    if not known:
        return np.zeros((0, 0))
    stacked = np.concatenate(known)
    return stacked[np.random.default_rng(len(stacked)).permutation(len(stacked))]


def extract(behaviour: Behaviour) -> Sums:
    """Count, sum and products of the features of a motion's windows."""
    features = behaviour.features
    assert features is not None
    full = np.pad(features, ((0, 0), (0, MAX_FEATURES - features.shape[1])))
    return {
        "feature.windows": len(full),
        "feature.sum": full.sum(axis=0),
        "feature.products": (full.T @ full).ravel(),
    }


OBSERVER = Extractor(extract, NEEDS)


def _gaussians(totals: Totals) -> list[Gaussian]:
    found = []
    for count, total, products in zip(
        *(totals[f"feature.{name}"] for name in ("windows", "sum", "products")), strict=True
    ):
        mean = total / max(count, 1)
        square = products.reshape(MAX_FEATURES, MAX_FEATURES) / max(count, 1)
        found.append(Gaussian(mean, square - np.outer(mean, mean)))
    return found


def _frechet(totals: Totals, other: Totals) -> Float[ndarray, " D"]:
    theirs = _gaussians(other)
    ours = _gaussians(totals)
    return np.array([frechet(one, theirs[index % len(theirs)]) for index, one in enumerate(ours)])


def _permuted(ours: WindowFeatures, theirs: WindowFeatures, paired: bool) -> Statistic:
    value = permutation_p_value(ours, theirs, PERMUTATIONS, seed=0)
    return lambda clips: value


def _share(ours: WindowFeatures, theirs: WindowFeatures, paired: bool, side: str) -> Statistic:
    """Statistic over resampled clips: fraction of our windows that are precise, or of their windows covered."""
    found = precision_coverage(ours, theirs, NEIGHBOURS)
    values, clip = (found.precise, ours.clip) if side == "precision" else (found.covered, theirs.clip)
    count = int(max(ours.clip.max(), theirs.clip.max())) + 1

    def statistic(clips: ndarray) -> float:
        times = np.bincount(clips, minlength=count)[clip]
        return float(times @ values / max(times.sum(), 1))

    return statistic


_feature = partial(Metric, extractor=OBSERVER, count_key="feature.windows", min_count=MIN_WINDOWS)

METRICS = (
    _feature(
        "features/frechet",
        "Frechet distance",
        "",
        "squared Frechet distance between Gaussians fitted to the features of windows of 2.56 s (fixed encoder)",
        compare=_frechet,
        direction=LOWER,
        source="Heusel et al. 2017; FGD: Yoon et al. 2020",
        caveat=(
            "biased upwards, more so with fewer windows; disagrees with human raters (GENEA): compare with the "
            "split-half floor"
        ),
    ),
    _feature(
        "features/mmd",
        "MMD^2",
        "",
        "unbiased MMD^2 of the features, Gaussian kernel of median width, without pairs from the same sound",
        pairwise=mmd_statistic,
        direction=LOWER,
        source="Gretton et al. 2012",
        caveat="can be negative; a significant difference need not be visible",
    ),
    _feature(
        "features/mmd_p_value",
        "MMD, permutation test",
        "p",
        f"fraction of {PERMUTATIONS} random assignments of whole sounds to two sets with an MMD at least as large",
        pairwise=_permuted,
        direction=HIGHER,
        source="Gretton et al. 2012",
        caveat="small for any model, given enough clips: shows that there is a difference, not its size; no interval",
    ),
    _feature(
        "features/precision",
        "precision",
        "fraction",
        f"fraction of windows that lie within the {NEIGHBOURS}rd-neighbour ball of some true window",
        pairwise=partial(_share, side="precision"),
        direction=HIGHER,
        source="Kynkaanniemi et al. 2019",
        caveat="highest for motion with little movement: read it together with coverage",
    ),
    _feature(
        "features/coverage",
        "coverage",
        "fraction",
        "fraction of true windows whose ball, of the same kind, contains a window of the motions",
        pairwise=partial(_share, side="coverage"),
        direction=HIGHER,
        source="Naeem et al. 2020",
        caveat="depends on the number of windows, which is therefore the same for both",
    ),
)
