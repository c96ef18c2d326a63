"""Fixations: what lies between saccades, or what stays within a window (I-DT, Salvucci & Goldberg 2000).

`detect_fixations` takes the stretches between found saccades, so it is as good as those are. I-DT is the second way,
with thresholds of its own: a fixation is 100 ms or longer and its extent, (max - min) of yaw plus (max - min) of
pitch, is at most 1 degree. Both read gaze in space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.evaluation.detectors.saccades import Saccades, detect_saccades
from talkingeyes.evaluation.detectors.signal import Runs, runs, valid_frames

MIN_DURATION_S = 0.1
MAX_DISPERSION_DEG = 1.0


@dataclass(frozen=True)
class Fixations:
    """N fixations in order of time: mean (yaw, pitch), and root mean square angle from it."""

    onset_s: Float[ndarray, " N"]
    offset_s: Float[ndarray, " N"]
    centre_rad: Float[ndarray, "N 2"]
    dispersion_deg: Float[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.onset_s)

    @property
    def duration_s(self) -> Float[ndarray, " N"]:
        """From onset to offset."""
        return np.asarray(self.offset_s - self.onset_s)


def detect_fixations(
    gaze_in_space_rad: Float[ndarray, "T 2"],
    fps: float,
    valid: Bool[ndarray, " T"] | None = None,
    saccades: Saccades | None = None,
) -> Fixations:
    """Stretches of 100 ms or longer that hold neither a saccade (found here unless given) nor an invalid frame."""
    known = valid_frames("gaze in space", gaze_in_space_rad, fps, valid)
    found = detect_saccades(gaze_in_space_rad, fps, known) if saccades is None else saccades
    frames = len(known)
    # A saccade takes the frames from its onset to its offset; one that lies between two frames takes neither.
    first = np.clip(np.ceil(found.onset_s * fps - 1e-6).astype(np.int64), 0, frames)
    after = np.clip(np.floor(found.offset_s * fps + 1e-6).astype(np.int64) + 1, 0, frames)
    moving = np.cumsum(np.bincount(first, minlength=frames + 1) - np.bincount(after, minlength=frames + 1))
    starts, ends = np.zeros(frames + 1, bool), np.zeros(frames + 1, bool)
    starts[after], ends[first] = True, True
    still = runs(known & (moving[:-1] <= 0), starts[:-1])
    # Times are those of the saccades on either side, which are finer than frames; those of frames where there is none.
    onset, offset = still.first / fps, still.last / fps
    before, behind = starts[still.first], ends[still.last + 1]
    onset[before] = found.offset_s[np.searchsorted(after, still.first[before], side="right") - 1]
    offset[behind] = found.onset_s[np.searchsorted(first, still.last[behind] + 1)]
    return _described(gaze_in_space_rad, still, onset, offset)


def detect_fixations_idt(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Fixations:
    """I-DT: a window of 100 ms that is within the extent grows until it is not."""
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
    """How far a window from `start` reaches before it is wider than the extent."""
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
    """Fixations of runs of frames, those that are long enough."""
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
