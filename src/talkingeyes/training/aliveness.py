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
class Aliveness:
    """Mean eye-in-head speed and its 99th percentile, mean head speed (degrees a second), stillness in space."""

    speed: float
    speed_99: float
    still_in_space: float
    head_speed: float

    def distance(self, truth: Aliveness) -> float:
        """0 when alive as the truth: log ratios of speeds and four times the difference in still frames."""
        ratios = [(self.speed, truth.speed), (self.speed_99, truth.speed_99), (self.head_speed, truth.head_speed)]
        return sum(abs(math.log(max(a, 0.1) / max(b, 0.1))) for a, b in ratios) + 4 * abs(
            self.still_in_space - truth.still_in_space
        )


def aliveness(head: Sequence[Float[ndarray, "T 3"]], gaze: Sequence[Float[ndarray, "T 2 3"]], fps: float) -> Aliveness:
    """Figures of several motions together."""
    eye = np.concatenate([kinematics.eye_speed_deg_s(each, fps) for each in gaze])
    space = np.concatenate([kinematics.space_speed_deg_s(h, g, fps) for h, g in zip(head, gaze, strict=True)])
    turned = np.concatenate([kinematics.head_speed_deg_s(each, fps) for each in head])
    return Aliveness(float(eye.mean()), float(np.quantile(eye, 0.99)), kinematics.still(space), float(turned.mean()))
