"""Free-running statistics of generated motion, compared with those of the truth: speeds and still frames.

A teacher-forced loss cannot detect frozen motion: copying the last frame beats it (docs/log.md). So every training of a
gaze generator is monitored, and its weights selected, by these statistics on val, with the model's own head.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import kinematics


@dataclass(frozen=True)
class FreeRunningStatistics:
    """Mean and 99th percentile of eye-in-head speed, mean head speed (degrees per second), still fraction in space."""

    eye_speed: float
    eye_speed_p99: float
    still_fraction_in_space: float
    head_speed: float

    def distance(self, truth: FreeRunningStatistics) -> float:
        """Distance from the truth (0 is best): absolute log ratios of speeds plus four times the difference in still
        fractions."""
        ratios = [
            (self.eye_speed, truth.eye_speed),
            (self.eye_speed_p99, truth.eye_speed_p99),
            (self.head_speed, truth.head_speed),
        ]
        return sum(abs(math.log(max(a, 0.1) / max(b, 0.1))) for a, b in ratios) + 4 * abs(
            self.still_fraction_in_space - truth.still_fraction_in_space
        )


def free_running_statistics(
    head: Sequence[Float[ndarray, "T 3"]], gaze: Sequence[Float[ndarray, "T 2 3"]], fps: float
) -> FreeRunningStatistics:
    """Statistics of several motions together."""
    eye = np.concatenate([kinematics.eye_speed_deg_s(each, fps) for each in gaze])
    space = np.concatenate([kinematics.gaze_in_space_speed_deg_s(h, g, fps) for h, g in zip(head, gaze, strict=True)])
    head_speeds = np.concatenate([kinematics.head_speed_deg_s(each, fps) for each in head])
    return FreeRunningStatistics(
        float(eye.mean()), float(np.quantile(eye, 0.99)), kinematics.still_fraction(space), float(head_speeds.mean())
    )
