"""Detection of fixations: intervals between saccades, or intervals of low dispersion (I-DT, Salvucci & Goldberg 2000).

`detect_fixations` takes the intervals between detected saccades, so it is only as good as the saccade detection. I-DT
is independent of it and has its own thresholds: a fixation lasts at least 100 ms and its extent, (max - min) of yaw
plus (max - min) of pitch, is at most 1 degree. Both use gaze in space.
"""

from __future__ import annotations

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
    """N fixations in order of time: mean direction (yaw, pitch), and root mean square angle to it."""

    centre_rad: Float[ndarray, "N 2"]
    dispersion_deg: Float[ndarray, " N"]


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
    window = max(2, int(np.ceil(MIN_DURATION_S * fps - 1e-9)) + 1)
    points = np.where(known[:, None], gaze_in_space_rad, np.inf).tolist()
    first, last = [], []
    start = 0
    while start + window <= len(points):
        stop = _grown(points, start, extent)
        if stop - start < window:
            start += 1
            continue
        first.append(start)
        last.append(stop - 1)
        start = stop
    found = Runs(np.array(first, np.int64), np.array(last, np.int64))
    return _described(gaze_in_space_rad, found, found.first / fps, found.last / fps)


def _grown(points: list[list[float]], start: int, extent: float) -> int:
    """End (exclusive) of the longest window from `start` within the extent."""
    low_yaw = high_yaw = points[start][0]
    low_pitch = high_pitch = points[start][1]
    for stop in range(start, len(points)):
        yaw, pitch = points[stop]
        low_yaw, high_yaw = min(low_yaw, yaw), max(high_yaw, yaw)
        low_pitch, high_pitch = min(low_pitch, pitch), max(high_pitch, pitch)
        if not high_yaw - low_yaw + high_pitch - low_pitch <= extent:
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
    counts = kept.last - kept.first + 1
    centre = _means(gaze_in_space_rad, kept.first, kept.last)
    index = np.repeat(kept.first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    owner = np.repeat(np.arange(len(kept)), counts)
    away = gaze_in_space_rad[index] - centre[owner]
    away[:, 0] *= np.cos(centre[owner, 1])
    square = np.bincount(owner, (away**2).sum(axis=1), minlength=len(kept)) / np.maximum(counts, 1)
    return Fixations(onset_s[long], offset_s[long], centre, np.degrees(np.sqrt(square)))


def _means(values: Float[ndarray, "T 2"], first: Int[ndarray, " N"], last: Int[ndarray, " N"]) -> Float[ndarray, "N 2"]:
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(np.nan_to_num(values), axis=0)])
    return np.asarray((summed[last + 1] - summed[first]) / (last - first + 1)[:, None])
