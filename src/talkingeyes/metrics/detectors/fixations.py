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

from talkingeyes.metrics.detectors.saccades import Saccades, detect_saccades
from talkingeyes.metrics.detectors.signal import Runs, runs, seen

LEAST_S = 0.1
EXTENT_DEG = 1.0


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
    known = seen("gaze in space", gaze_in_space_rad, fps, valid)
    found = detect_saccades(gaze_in_space_rad, fps, known) if saccades is None else saccades
    within = np.zeros(len(known) + 1, np.int64)
    last = len(known) - 1
    # The first frame after onset and the last before offset move; a saccade between two frames takes neither.
    np.add.at(within, np.clip(np.ceil(found.onset_s * fps).astype(np.int64), 0, last), 1)
    np.add.at(within, np.clip(np.floor(found.offset_s * fps).astype(np.int64) + 1, 0, len(known)), -1)
    crossed = np.zeros(len(known), bool)
    crossed[np.clip(np.ceil(found.offset_s * fps).astype(np.int64), 0, last)] = True
    still = known & (np.cumsum(within[:-1]) <= 0)
    return _described(gaze_in_space_rad, fps, runs(still, crossed))


def dispersion_threshold(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> Fixations:
    """I-DT: a window of 100 ms that is within the extent grows until it is not."""
    known = seen("gaze in space", gaze_in_space_rad, fps, valid)
    extent = np.radians(EXTENT_DEG)
    window = max(2, int(np.ceil(LEAST_S * fps - 1e-9)) + 1)
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
    return _described(gaze_in_space_rad, fps, Runs(np.array(first, np.int64), np.array(last, np.int64)))


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


def _described(gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, found: Runs) -> Fixations:
    """Fixations of runs of frames, those that are long enough."""
    long = found.where((found.last - found.first) / fps >= LEAST_S - 1e-9)
    counts = long.last - long.first + 1
    centre = _means(gaze_in_space_rad, long.first, long.last)
    frames = np.repeat(long.first - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(counts.sum())
    away = gaze_in_space_rad[frames] - np.repeat(centre, counts, axis=0)
    away[:, 0] *= np.cos(np.repeat(centre[:, 1], counts))
    owner = np.repeat(np.arange(len(long)), counts)
    square = np.bincount(owner, (away**2).sum(axis=1), minlength=len(long)) / np.maximum(counts, 1)
    return Fixations(long.first / fps, long.last / fps, centre, np.degrees(np.sqrt(square)))


def _means(values: Float[ndarray, "T 2"], first: Int[ndarray, " N"], last: Int[ndarray, " N"]) -> Float[ndarray, "N 2"]:
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(np.nan_to_num(values), axis=0)])
    return np.asarray((summed[last + 1] - summed[first]) / (last - first + 1)[:, None])
