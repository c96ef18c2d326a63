"""Head movements: bursts of rotation between two moments of slower turning.

The head of somebody who speaks never rests (Hadar et al. 1983), so a movement is not what lies between rests: it is a
peak of angular speed of `PEAK_DEG_S` or more, out to where speed has fallen to a quarter of it or rises again, that
turns the head by `LEAST_DEG` or more. A nod is two movements, down and up. Speed is taken over 80 ms, whatever the
frame rate, so that all rates find the same movements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.signal import argrelmin

from talkingeyes.metrics.detectors.signal import seen

PEAK_DEG_S = 8.0
LEAST_DEG = 1.0
EDGE = 0.25
WINDOW_S = 0.08


@dataclass(frozen=True)
class HeadMoves:
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


def detect_head_moves(head: Float[ndarray, "T 3"], fps: float, valid: Bool[ndarray, " T"] | None = None) -> HeadMoves:
    """Movements of the head's rotation vectors. Raises InputError."""
    known = seen("head", head, fps, valid)
    window = max(1, round(WINDOW_S * fps))
    turned = np.where(known[:, None], head, 0.0)
    # A head turns little enough for the difference of rotation vectors to be the turn between them (2 % at 20 degrees).
    velocity = (turned[window:] - turned[:-window]) * (fps / window)
    usable = known[window:] & known[:-window]
    speed = np.degrees(np.sqrt((velocity**2).sum(axis=1))) * usable
    minima = np.concatenate([[0], argrelmin(speed, mode="clip")[0], [len(speed) - 1]])
    found = []
    for left, right in zip(minima[:-1].tolist(), minima[1:].tolist(), strict=True):
        peak = left + int(np.argmax(speed[left : right + 1]))
        if speed[peak] < PEAK_DEG_S:
            continue
        low = np.flatnonzero(speed[left : right + 1] >= EDGE * speed[peak]) + left
        # Speed n lies between frames n and n + window; the movement reaches from the middle of one to that of another.
        first, last = int(low[0]) + window // 2, int(low[-1]) + (window + 1) // 2
        displacement = turned[last] - turned[first]
        if np.linalg.norm(displacement) >= np.radians(LEAST_DEG):
            found.append((first / fps, last / fps, *displacement, speed[peak]))
    table = np.array(found, np.float64).reshape(-1, 6)
    return HeadMoves(table[:, 0], table[:, 1], table[:, 2:5], table[:, 5])
