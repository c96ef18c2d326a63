"""How well found events agree with known ones: precision, recall, F1, onset error, and Cohen's kappa a sample.

Events pair one to one in order of time, each found one with the first known one that is still free within the
tolerance; among points on a line that gives as many pairs as there can be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray


@dataclass(frozen=True)
class Pairs:
    """Which found event is which known one."""

    found: Int[ndarray, " P"]
    known: Int[ndarray, " P"]


@dataclass(frozen=True)
class Score:
    """Agreement of `found` with `known` events; onset errors are found minus known, NaN without pairs."""

    precision: float
    recall: float
    f1: float
    onset_error_s: float  # median
    onset_iqr_s: float
    found: int
    known: int


def pair(found_s: Float[ndarray, " N"], known_s: Float[ndarray, " M"], tolerance_s: float) -> Pairs:
    """Pairs of ascending times that are at most the tolerance apart."""
    pairs = []
    free = 0
    for index, time_s in enumerate(found_s.tolist()):
        while free < len(known_s) and known_s[free] < time_s - tolerance_s:
            free += 1
        if free < len(known_s) and known_s[free] <= time_s + tolerance_s:
            pairs.append((index, free))
            free += 1
    left, right = np.array(pairs, np.int64).reshape(-1, 2).T
    return Pairs(left, right)


def score(found_s: Float[ndarray, " N"], known_s: Float[ndarray, " M"], tolerance_s: float) -> Score:
    """Precision, recall, F1 and onset errors of ascending onsets."""
    pairs = pair(found_s, known_s, tolerance_s)
    return scored(len(found_s), len(known_s), len(pairs.found), found_s[pairs.found] - known_s[pairs.known])


def scored(found: int, known: int, paired: int, error_s: Float[ndarray, " P"]) -> Score:
    """The score of counts and onset errors, which may be pooled over clips."""
    nan = float("nan")
    low, middle, high = np.percentile(error_s, [25, 50, 75]) if len(error_s) else (nan, nan, nan)
    return Score(
        precision=paired / found if found else nan,
        recall=paired / known if known else nan,
        f1=2 * paired / (found + known) if found + known else nan,
        onset_error_s=float(middle),
        onset_iqr_s=float(high - low),
        found=found,
        known=known,
    )


def kappa(one: Bool[ndarray, " T"], other: Bool[ndarray, " T"]) -> float:
    """Cohen's kappa of two labellings of the same samples: agreement beyond chance."""
    agreed = float((one == other).mean())
    chance = float(one.mean() * other.mean() + (~one).mean() * (~other).mean())
    return (agreed - chance) / (1.0 - chance) if chance < 1.0 else float("nan")
