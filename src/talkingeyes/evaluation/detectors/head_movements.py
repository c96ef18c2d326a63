"""Detection of head movements: bursts of rotation between two minima of angular speed.

The head of a speaker never rests (Hadar et al. 1983), so a movement cannot be defined as the interval between rests. It
is a peak of angular speed of at least `MIN_PEAK_DEG_S` that turns the head by at least `MIN_AMPLITUDE_DEG`. It extends
on both sides to where speed has fallen to a tenth of the peak or rises again. A nod is two movements, down and up.
Speed is computed over 80 ms at any frame rate, so that all rates give the same movements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.signal import TimedEvents, valid_frames

MIN_PEAK_DEG_S = 5.0
MIN_AMPLITUDE_DEG = 1.0
EDGE_FRACTION = 0.1
WINDOW_S = 0.08


@dataclass(frozen=True)
class HeadMovements(TimedEvents):
    """N movements in order of time; `displacement_rad` is the change of the rotation vector."""

    displacement_rad: Float[ndarray, "N 3"]
    peak_speed_deg_s: Float[ndarray, " N"]

    @property
    def amplitude_deg(self) -> Float[ndarray, " N"]:
        """Angle between the head poses at onset and offset."""
        return np.asarray(np.degrees(np.linalg.norm(self.displacement_rad, axis=1)))


def detect_head_movements(
    head: Float[ndarray, "T 3"], fps: float, valid: Bool[ndarray, " T"] | None = None
) -> HeadMovements:
    """Detect movements in rotation vectors of the head. Raises InputError (see `valid_frames`)."""
    known = valid_frames("head", head, fps, valid)
    window = max(1, round(WINDOW_S * fps))
    turned = np.where(known[:, None], head, 0.0)
    # Head rotations are small, so the difference of rotation vectors approximates the rotation (2 % off at 20 degrees).
    velocity = (turned[window:] - turned[:-window]) * (fps / window)
    usable = known[window:] & known[:-window]
    speed = np.degrees(np.sqrt((velocity**2).sum(axis=1))) * usable
    speed_minima = np.flatnonzero((speed[1:-1] < speed[:-2]) & (speed[1:-1] <= speed[2:])) + 1
    starts = np.concatenate([[0], speed_minima])
    peaks = np.maximum.reduceat(speed, starts)
    # Between two minima speed rises once and falls once, so the frames above the edge form one run.
    index = np.arange(len(speed))
    above = speed >= EDGE_FRACTION * np.repeat(peaks, np.diff(np.concatenate([starts, [len(speed)]])))
    low = np.minimum.reduceat(np.where(above, index, len(speed)), starts)
    high = np.maximum.reduceat(np.where(above, index, -1), starts)
    # Speed n spans frames n to n + window; a movement extends from the middle of its first span to that of its last.
    first, last = low + window // 2, high + (window + 1) // 2
    displacement = turned[last] - turned[first]
    kept = (peaks >= MIN_PEAK_DEG_S) & (np.linalg.norm(displacement, axis=1) >= np.radians(MIN_AMPLITUDE_DEG))
    return HeadMovements(first[kept] / fps, last[kept] / fps, displacement[kept], peaks[kept])
