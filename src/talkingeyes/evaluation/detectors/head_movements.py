"""Head movements: bursts of rotation between two moments of slower turning.

The head of somebody who speaks never rests (Hadar et al. 1983), so a movement is not what lies between rests: it is a
peak of angular speed of `MIN_PEAK_DEG_S` or more, out to where speed has fallen to a tenth of it or rises again, that
turns the head by `MIN_AMPLITUDE_DEG` or more. A nod is two movements, down and up. Speed is taken over 80 ms, whatever
the frame rate, so that all rates find the same movements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.signal import valid_frames

MIN_PEAK_DEG_S = 5.0
MIN_AMPLITUDE_DEG = 1.0
EDGE_FRACTION = 0.1
WINDOW_S = 0.08


@dataclass(frozen=True)
class HeadMovements:
    """N movements in order of time; `displacement_rad` is the change of the rotation vector."""

    onset_s: Float[ndarray, " N"]
    offset_s: Float[ndarray, " N"]
    displacement_rad: Float[ndarray, "N 3"]
    peak_speed_deg_s: Float[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.onset_s)

    @property
    def amplitude_deg(self) -> Float[ndarray, " N"]:
        """Angle that the head turns by."""
        return np.asarray(np.degrees(np.linalg.norm(self.displacement_rad, axis=1)))

    @property
    def duration_s(self) -> Float[ndarray, " N"]:
        """From onset to offset."""
        return np.asarray(self.offset_s - self.onset_s)


def detect_head_movements(
    head: Float[ndarray, "T 3"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> HeadMovements:
    """Movements of the head's rotation vectors. Raises InputError."""
    known = valid_frames("head", head, fps, valid)
    window = max(1, round(WINDOW_S * fps))
    turned = np.where(known[:, None], head, 0.0)
    # A head turns little enough for the difference of rotation vectors to be the turn between them (2 % at 20 degrees).
    velocity = (turned[window:] - turned[:-window]) * (fps / window)
    usable = known[window:] & known[:-window]
    speed = np.degrees(np.sqrt((velocity**2).sum(axis=1))) * usable
    speed_minima = np.flatnonzero((speed[1:-1] < speed[:-2]) & (speed[1:-1] <= speed[2:])) + 1
    starts = np.concatenate([[0], speed_minima])
    peaks = np.maximum.reduceat(speed, starts)
    # Between two dips speed rises once and falls once, so what is above the edge is one stretch.
    index = np.arange(len(speed))
    above = speed >= EDGE_FRACTION * np.repeat(peaks, np.diff(np.concatenate([starts, [len(speed)]])))
    low = np.minimum.reduceat(np.where(above, index, len(speed)), starts)
    high = np.maximum.reduceat(np.where(above, index, -1), starts)
    # Speed n lies between frames n and n + window; the movement reaches from the middle of one to that of another.
    first, last = low + window // 2, high + (window + 1) // 2
    displacement = turned[last] - turned[first]
    kept = (peaks >= MIN_PEAK_DEG_S) & (np.linalg.norm(displacement, axis=1) >= np.radians(MIN_AMPLITUDE_DEG))
    return HeadMovements(first[kept] / fps, last[kept] / fps, displacement[kept], peaks[kept])
