"""Measures in the features of windows, by the fixed encoder: Frechet distance, MMD, precision and coverage.

Frechet distance is a figure of sums (count, sum and products of the features). MMD, precision and coverage compare
windows pairwise: they take a fixed number of them, drawn evenly over the sounds (evaluation/distribution/).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import HIGHER, LOWER, Extractor, Metric, Sums, Totals
from talkingeyes.evaluation.bootstrap import Statistic
from talkingeyes.evaluation.distribution.coverage import precision_coverage
from talkingeyes.evaluation.distribution.frechet import Gaussian, frechet
from talkingeyes.evaluation.distribution.mmd import WindowFeatures, mmd_statistic, permutation_p_value

# Head and gaze of S samples, and their frame rate, to the features of all windows, sample by sample.
Encoder = Callable[[ndarray, ndarray, float], ndarray]

MAX_FEATURES = 16  # sums are as long as this; an encoder of fewer leaves zeros, which change no distance
NEIGHBOURS = 3
PERMUTATIONS = 200
MIN_WINDOWS = 100
NEEDS = ("head", "gaze", "features")


def add_features(motions: Sequence[Behaviour], encoder: Encoder | None) -> list[Behaviour]:
    """Motions with the features of their windows."""
    if encoder is None:
        return list(motions)
    return [
        motion
        if motion.head is None or motion.gaze is None
        else replace(motion, features=encoder(motion.head[None], motion.gaze[None], motion.fps))
        for motion in motions
    ]


def gather_features(motions: Sequence[Behaviour]) -> Float[ndarray, "W D"]:
    """The features of all windows of all motions, in mixed order, so that the first few are any few."""
    known = [motion.features for motion in motions if motion.features is not None]
    if not known:
        return np.zeros((0, 0))
    stacked = np.concatenate(known)
    return stacked[np.random.default_rng(len(stacked)).permutation(len(stacked))]


def extract(behaviour: Behaviour) -> Sums:
    """Moments of the features of a motion's windows."""
    features = behaviour.features
    assert features is not None
    full = np.pad(features, ((0, 0), (0, MAX_FEATURES - features.shape[1])))
    return {
        "feature.windows": len(full),
        "feature.sum": full.sum(axis=0),
        "feature.products": (full.T @ full).ravel(),
    }


OBSERVER = Extractor(
    extract,
    NEEDS,
    {"feature.windows": 1, "feature.sum": MAX_FEATURES, "feature.products": MAX_FEATURES**2},
)


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


def _mmd(ours: WindowFeatures, theirs: WindowFeatures, paired: bool) -> Statistic:
    return mmd_statistic(ours, theirs, paired)


def _permuted(ours: WindowFeatures, theirs: WindowFeatures, paired: bool) -> Statistic:
    value = permutation_p_value(ours, theirs, PERMUTATIONS, seed=0)
    return lambda clips: value


def _share(ours: WindowFeatures, theirs: WindowFeatures, paired: bool, side: str) -> Statistic:
    """Share of windows, ours that are precise or theirs that are covered, over drawn clips."""
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
        "squared Frechet distance of two Gaussians of the features of windows of 2.56 s, by the fixed encoder",
        compare=_frechet,
        direction=LOWER,
        source="Heusel et al. 2017; FGD: Yoon et al. 2020",
        caveat="biased upwards by the number of features over windows; people disagree with it (GENEA): read the floor",
    ),
    _feature(
        "features/mmd",
        "MMD^2",
        "",
        "unbiased MMD^2 of the features with a Gaussian kernel of the median width, pairs within a sound left out",
        pairwise=_mmd,
        direction=LOWER,
        source="Gretton et al. 2012",
        caveat="may be negative; a difference that it finds need not be one that anybody sees",
    ),
    _feature(
        "features/mmd_p_value",
        "MMD, permutation p",
        "p",
        f"share of {PERMUTATIONS} deals of whole sounds to two sets that are as far apart",
        pairwise=_permuted,
        direction=HIGHER,
        source="Gretton et al. 2012",
        caveat="small with enough clips for any model: says whether, not how much; no interval",
    ),
    _feature(
        "features/precision",
        "precision",
        "share",
        f"share of windows inside the ball to the {NEIGHBOURS}rd neighbour of any true window",
        pairwise=partial(_share, side="precision"),
        direction=HIGHER,
        source="Kynkaanniemi et al. 2019",
        caveat="the calmest motion has the best: read it beside coverage",
    ),
    _feature(
        "features/coverage",
        "coverage",
        "share",
        "share of true windows whose ball holds a window of the motions",
        pairwise=partial(_share, side="coverage"),
        direction=HIGHER,
        source="Naeem et al. 2020",
        caveat="depends on how many windows are drawn: the same number of both",
    ),
)
