"""Detection of blinks in lid closure.

A blink rises at least `MIN_PEAK_CLOSURE` above the clip's resting closure (its median, as people differ in how wide
they open their eyes) and lasts while closure is above `EDGE_FRACTION` of its own depth. If the lids do not reopen at
least half way between two peaks, the peaks count as one blink. A closure longer than one second is not a blink (Doughty
2001 reports 334 +- 67 ms). Times are interpolated between frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.signal import TimedEvents, runs, valid_frames

MIN_PEAK_CLOSURE = 0.3
EDGE_FRACTION = 0.1
REOPENING_FRACTION = 0.5
MAX_DURATION_S = 1.0


@dataclass(frozen=True)
class Blinks(TimedEvents):
    """N blinks in order of time: time of the peak, and the closure of the lids at it (1: shut)."""

    peak_s: Float[ndarray, " N"]
    depth: Float[ndarray, " N"]


def detect_blinks(
    lid: Float[ndarray, " T"] | Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Blinks:
    """Detect blinks in lid closure per frame, or in the mean of both eyes. Raises InputError (see `valid_frames`).

    Closure is 0 at the opening that gaze alone gives and 1 when the eye is shut.
    """
    both = lid.reshape(len(lid), -1)
    known = valid_frames("lids", both, fps, valid)
    closure = both.mean(axis=1)
    rest = float(np.median(closure[known])) if known.any() else 0.0
    above = np.where(known, closure - rest, 0.0)
    found = []
    last_stop = 0
    for first, last in _cores(above):
        peak = first + int(np.argmax(above[first : last + 1]))
        edge = EDGE_FRACTION * above[peak]
        start, stop = peak, peak
        while start > last_stop and above[start - 1] < above[start] + edge and above[start] > edge:
            start -= 1
        while stop < len(above) - 1 and above[stop + 1] < above[stop] + edge and above[stop] > edge:
            stop += 1
        last_stop = stop
        if (stop - start) / fps <= MAX_DURATION_S:
            found.append(
                (
                    _crossing(above, start, 1, edge) / fps,
                    _crossing(above, stop, -1, edge) / fps,
                    peak / fps,
                    closure[peak],
                )
            )
    columns = np.array(found, np.float64).reshape(-1, 4).T
    return Blinks(*columns)


def _cores(above: Float[ndarray, " T"]) -> list[tuple[int, int]]:
    """Runs above `MIN_PEAK_CLOSURE`, joined where the lids do not reopen half way between two peaks."""
    found = runs(above >= MIN_PEAK_CLOSURE)
    joined: list[tuple[int, int]] = []
    for first, last in zip(found.first.tolist(), found.last.tolist(), strict=True):
        if joined:
            start, stop = joined[-1]
            lower = min(above[start : stop + 1].max(), above[first : last + 1].max())
            if above[stop : first + 1].min() > REOPENING_FRACTION * lower:
                joined[-1] = (start, last)
                continue
        joined.append((first, last))
    return joined


def _crossing(above: Float[ndarray, " T"], outer: int, towards: int, level: float) -> float:
    """Time in frames at which closure crosses `level`, between the frame `outer` and the next one towards the peak."""
    inner = min(max(outer + towards, 0), len(above) - 1)
    rise = above[inner] - above[outer]
    share = (level - above[outer]) / rise if rise > 0 else 0.0
    return outer + towards * float(np.clip(share, 0.0, 1.0))
