"""Gaze from events of a point process of saccades (point_process.py), in numpy: directions over time, then eyes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.physiology import eye_head, saccades

# Offset of the seed of gaze, so that gaze does not reuse the random numbers of the head.
SEED_OFFSET = 1_000_003
MAX_SACCADE_S = 1.0  # upper bound of the duration of a saccade


class SaccadeSequence:
    """Gaze directions of both eyes over time: main-sequence saccades, each from the landing of the one before. A
    saccade that would start before the last one has ended is delayed. Past saccades can be discarded."""

    def __init__(self, location_rad: Float[ndarray, " 3"]) -> None:
        """Start at a location."""
        self._location_rad = location_rad
        self._timing = np.empty((0, 3))  # onset and duration in seconds, skew
        self._from_rad, self._to_rad = np.empty((0, 3)), np.empty((0, 3))

    def __len__(self) -> int:
        return len(self._timing)

    def add_saccades(self, onsets_s: Float[ndarray, " K"], to_rad: Float[ndarray, "K 3"]) -> None:
        """Append K saccades with non-decreasing onsets."""
        start = np.concatenate([self._location_rad[None], to_rad])
        amplitude = np.hypot(*(to_rad - start[:-1])[:, :2].T)
        duration_s = saccades.duration_s(amplitude)
        before_s = np.cumsum(duration_s) - duration_s
        free_s = self._timing[-1:, :2].sum(1)  # end of the last saccade
        onset_s = before_s + np.maximum.accumulate(np.concatenate([free_s, onsets_s - before_s]))[len(free_s) :]
        timing = np.stack([onset_s, duration_s, saccades.skew(amplitude)], axis=1)
        self._timing = np.concatenate([self._timing, timing])
        self._from_rad = np.concatenate([self._from_rad, start[:-1]])
        self._to_rad, self._location_rad = np.concatenate([self._to_rad, to_rad]), start[-1]

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 4"]:
        """Yaw and pitch of the left and the right eye at the given times."""
        if not len(self):
            cyclopean, half_vergence = (
                np.tile(self._location_rad[:2], (len(times_s), 1)),
                np.full(len(times_s), self._location_rad[2]),
            )
        else:
            onset_s, duration_s, skew = self._timing.T
            now = saccades.saccade_progress(onset_s, duration_s, skew, times_s)
            start, way = self._from_rad[now.index], (self._to_rad - self._from_rad)[now.index]
            cyclopean = start[:, :2] + way[:, :2] * now.completed[:, None]
            half_vergence = start[:, 2] + way[:, 2] * now.phase
        signal = np.concatenate([cyclopean, cyclopean], axis=1)
        signal[:, 0] += half_vergence
        signal[:, 2] -= half_vergence
        return signal

    def discard_before(self, time_s: float) -> None:
        """Discard saccades that are not needed from `time_s` on."""
        over = max(int(np.searchsorted(self._timing[:, 0], time_s, side="right")) - 1, 0)
        self._timing, self._from_rad, self._to_rad = (
            each[over:] for each in (self._timing, self._from_rad, self._to_rad)
        )


def render_saccades(
    event: Bool[ndarray, "B N"],
    onsets_s: Float[ndarray, "B N"],
    locations_rad: Float[ndarray, "B N 3"],
    times_s: Float[ndarray, " T"],
) -> Float[ndarray, "B T 4"]:
    """Yaw and pitch of both eyes at any times; the first event of a row is its initial location.

    All rows are rendered as one concatenated sequence, because many small numpy steps cost more than one long one.
    """
    row, index = np.nonzero(event)
    # Time between two rows, longer than all saccades of a row together, should they delay each other.
    begins_s = np.arange(len(event)) * (times_s[-1] + MAX_SACCADE_S * (event.shape[1] + 1))
    onset_s = begins_s[row] + np.where(index, onsets_s[row, index], -MAX_SACCADE_S)
    chain = SaccadeSequence(locations_rad[0, 0])
    chain.add_saccades(onset_s, locations_rad[row, index])
    signal = chain.at((begins_s[:, None] + times_s).ravel())
    return signal.reshape(len(event), len(times_s), 4)


def eyes_towards(head: Float[ndarray, "B T 3"], signal: Float[ndarray, "B T 4"]) -> Float[ndarray, "B T 2 3"]:
    """Eye-in-head for a direction in space, limited to the range of the eyes; beyond it, gaze moves with the head."""
    directions = signal.astype(np.float32).reshape(*signal.shape[:-1], 2, 2)
    return eye_head.clamp_to_eye_range(rotation.eye_in_head(head, directions))
