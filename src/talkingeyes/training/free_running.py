"""Is motion alive when a model runs free? Eye speed, its 99th percentile, still frames, beside the truth's.

A teacher-forced loss cannot tell: copying the last frame beats it (docs/log.md). So every training of a gaze generator
is watched, and its weights chosen, by these figures on val, with the model's own head.
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
    """Mean eye-in-head speed and its 99th percentile, mean head speed (degrees a second), stillness in space."""

    eye_speed: float
    eye_speed_p99: float
    still_fraction_in_space: float
    head_speed: float

    def distance(self, truth: FreeRunningStatistics) -> float:
        """0 when alive as the truth: log ratios of speeds and four times the difference in still frames."""
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
    """Figures of several motions together."""
    eye = np.concatenate([kinematics.eye_speed_deg_s(each, fps) for each in gaze])
    space = np.concatenate([kinematics.gaze_in_space_speed_deg_s(h, g, fps) for h, g in zip(head, gaze, strict=True)])
    head_speeds = np.concatenate([kinematics.head_speed_deg_s(each, fps) for each in head])
    return FreeRunningStatistics(
        float(eye.mean()), float(np.quantile(eye, 0.99)), kinematics.still_fraction(space), float(head_speeds.mean())
    )
