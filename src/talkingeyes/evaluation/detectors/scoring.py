"""Agreement of detected with reference events: precision, recall, F1, onset error, and Cohen's kappa per sample.

Events are matched one to one in order of time: each detected event is paired with the first unmatched reference event
within the tolerance. For points on a line this gives the largest possible number of pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray


@dataclass(frozen=True)
class EventMatches:
    """Indices of matched pairs: detected (`found`) and reference (`known`) events."""

    found: Int[ndarray, " P"]
    known: Int[ndarray, " P"]


@dataclass(frozen=True)
class DetectionScore:
    """Agreement of detected with reference events; onset errors are detected minus reference, NaN without pairs."""

    precision: float
    recall: float
    f1: float
    onset_error_s: float  # median
    onset_iqr_s: float
    found: int
    known: int


def match_events(found_s: Float[ndarray, " N"], known_s: Float[ndarray, " M"], tolerance_s: float) -> EventMatches:
    """Match ascending times that differ by at most the tolerance."""
    pairs = []
    free = 0
    for index, time_s in enumerate(found_s.tolist()):
        while free < len(known_s) and known_s[free] < time_s - tolerance_s:
            free += 1
        if free < len(known_s) and known_s[free] <= time_s + tolerance_s:
            pairs.append((index, free))
            free += 1
    left, right = np.array(pairs, np.int64).reshape(-1, 2).T
    return EventMatches(left, right)


@dataclass(frozen=True)
class DetectionCounts:
    """Counts and onset errors (detected minus reference), summed over clips with `+`."""

    found: int = 0
    known: int = 0
    matched: int = 0
    errors_s: tuple[float, ...] = ()

    def __add__(self, other: DetectionCounts) -> DetectionCounts:
        return DetectionCounts(
            self.found + other.found,
            self.known + other.known,
            self.matched + other.matched,
            self.errors_s + other.errors_s,
        )

    @property
    def score(self) -> DetectionScore:
        """Precision, recall, F1 and onset error of the counts."""
        nan = float("nan")
        low, middle, high = np.percentile(self.errors_s, [25, 50, 75]) if self.errors_s else (nan, nan, nan)
        return DetectionScore(
            precision=self.matched / self.found if self.found else nan,
            recall=self.matched / self.known if self.known else nan,
            f1=2 * self.matched / (self.found + self.known) if self.found + self.known else nan,
            onset_error_s=float(middle),
            onset_iqr_s=float(high - low),
            found=self.found,
            known=self.known,
        )


def count_matches(found_s: Float[ndarray, " N"], known_s: Float[ndarray, " M"], tolerance_s: float) -> DetectionCounts:
    """Match ascending onsets of one clip and count."""
    pairs = match_events(found_s, known_s, tolerance_s)
    errors = found_s[pairs.found] - known_s[pairs.known]
    return DetectionCounts(len(found_s), len(known_s), len(errors), tuple(errors.tolist()))


def event_mask(
    onset_s: Float[ndarray, " N"], offset_s: Float[ndarray, " N"], fps: float, frames: int
) -> Bool[ndarray, " T"]:
    """Mask of the frames within events, both ends included."""
    change = np.zeros(frames + 1, np.int64)
    np.add.at(change, np.clip(np.round(onset_s * fps).astype(np.int64), 0, frames), 1)
    np.add.at(change, np.clip(np.round(offset_s * fps).astype(np.int64) + 1, 0, frames), -1)
    return np.asarray(np.cumsum(change[:-1]) > 0)


def cohen_kappa(one: Bool[ndarray, " T"], other: Bool[ndarray, " T"]) -> float:
    """Cohen's kappa of two labellings of the same samples: agreement beyond chance."""
    agreed = float((one == other).mean())
    chance = float(one.mean() * other.mean() + (~one).mean() * (~other).mean())
    return (agreed - chance) / (1.0 - chance) if chance < 1.0 else float("nan")
