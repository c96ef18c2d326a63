"""Detection of fixations: intervals between saccades, or intervals of low dispersion (I-DT, Salvucci & Goldberg 2000).

`detect_fixations` takes the intervals between detected saccades, so it is only as good as the saccade detection. I-DT
is independent of it and has its own thresholds: a fixation lasts at least 100 ms and its extent, (max - min) of yaw
plus (max - min) of pitch, is at most 1 degree. Both use gaze in space.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.evaluation.detectors.saccades import Saccades, detect_saccades
from talkingeyes.evaluation.detectors.signal import Runs, TimedEvents, runs, valid_frames

MIN_DURATION_S = 0.1
MAX_DISPERSION_DEG = 1.0


@dataclass(frozen=True)
class Fixations(TimedEvents):
    """N fixations in order of time: mean direction (yaw, pitch)."""

    centre_rad: Float[ndarray, "N 2"]


def detect_fixations(
    gaze_in_space_rad: Float[ndarray, "T 2"],
    fps: float,
    valid: Bool[ndarray, " T"] | None = None,
    saccades: Saccades | None = None,
) -> Fixations:
    """Detect fixations: intervals of at least 100 ms without a saccade or an invalid frame. Raises InputError.

    Saccades are detected unless they are given.
    """
    known = valid_frames("gaze in space", gaze_in_space_rad, fps, valid)
    found = detect_saccades(gaze_in_space_rad, fps, known) if saccades is None else saccades
    frames = len(known)
    # A saccade occupies the frames from its onset to its offset; one that lies between two frames occupies neither.
    first = np.clip(np.ceil(found.onset_s * fps - 1e-6).astype(np.int64), 0, frames)
    after = np.clip(np.floor(found.offset_s * fps + 1e-6).astype(np.int64) + 1, 0, frames)
    moving = np.cumsum(np.bincount(first, minlength=frames + 1) - np.bincount(after, minlength=frames + 1))
    starts, ends = np.zeros(frames + 1, bool), np.zeros(frames + 1, bool)
    starts[after], ends[first] = True, True
    still = runs(known & (moving[:-1] <= 0), starts[:-1])
    # Onset and offset are those of adjacent saccades, which are finer than frames; without one, those of frames.
    onset, offset = still.first / fps, still.last / fps
    before, behind = starts[still.first], ends[still.last + 1]
    onset[before] = found.offset_s[np.searchsorted(after, still.first[before], side="right") - 1]
    offset[behind] = found.onset_s[np.searchsorted(first, still.last[behind] + 1)]
    return _described(gaze_in_space_rad, still, onset, offset)


def detect_fixations_idt(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Fixations:
    """Detect fixations with I-DT: a window of 100 ms within the extent grows until it exceeds it. Raises InputError."""
    known = valid_frames("gaze in space", gaze_in_space_rad, fps, valid)
    extent = np.radians(MAX_DISPERSION_DEG)
    min_frames = max(2, int(np.ceil(MIN_DURATION_S * fps - 1e-9)) + 1)
    points = np.where(known[:, None], gaze_in_space_rad, np.inf)
    spans = low_dispersion_spans(points, min_frames, lambda x, y: x + y <= extent)
    found = Runs(*np.array(spans, np.int64).reshape(-1, 2).T)
    return _described(gaze_in_space_rad, found, found.first / fps, found.last / fps)


def low_dispersion_spans(
    points: Float[ndarray, "T 2"], min_frames: int, within: Callable[[float, float], bool]
) -> list[tuple[int, int]]:
    """First and last frame of each span of `min_frames` or more by I-DT; `within` judges its extents in x and y."""
    found, start, listed = [], 0, points.tolist()
    while start + min_frames <= len(listed):
        stop = _grown(listed, start, within)
        if stop - start < min_frames:
            start += 1
            continue
        found.append((start, stop - 1))
        start = stop
    return found


def _grown(points: list[list[float]], start: int, within: Callable[[float, float], bool]) -> int:
    """End (exclusive) of the longest span from `start` whose extents are within the limit."""
    low_x = high_x = points[start][0]
    low_y = high_y = points[start][1]
    for stop in range(start, len(points)):
        x, y = points[stop]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
        if not within(high_x - low_x, high_y - low_y):
            return stop
    return len(points)


def _described(
    gaze_in_space_rad: Float[ndarray, "T 2"],
    frames: Runs,
    onset_s: Float[ndarray, " N"],
    offset_s: Float[ndarray, " N"],
) -> Fixations:
    """Build fixations from runs of frames, dropping those that are too short."""
    long = offset_s - onset_s >= MIN_DURATION_S - 1e-9
    kept = frames.where(long)
    return Fixations(onset_s[long], offset_s[long], mean_directions(gaze_in_space_rad, kept.first, kept.last))


def mean_directions(
    directions: Float[ndarray, "T 2"], first: Int[ndarray, " N"], last: Int[ndarray, " N"]
) -> Float[ndarray, "N 2"]:
    """Mean direction from the first to the last frame of each of N spans."""
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(np.nan_to_num(directions), axis=0)])
    return np.asarray((summed[last + 1] - summed[first]) / (last - first + 1)[:, None])
