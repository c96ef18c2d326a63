"""No saccade is larger than saccades are in conversation (Lee, Badler & Badler 2002)."""

from __future__ import annotations

import numpy as np

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import MIN_STEP_RAD, GazeTrajectory, shift_fixations, split_fixations
from talkingeyes.physiology import saccades

MAX_AMPLITUDE_RAD = float(np.radians(saccades.MAX_TALKING_AMPLITUDE_DEG))
MIN_FIXATION_S = 0.2


def limit_amplitude(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Shorten saccades beyond the limit; a corrective saccade follows, unless the next one comes first.

    Off with `no_postprocessing`.
    """
    over = np.hypot(*trajectory.steps_rad.T) > MAX_AMPLITUDE_RAD
    if context.controls.no_postprocessing or not over.any():
        return trajectory
    onset_s = np.array([each.onset_s for each in trajectory.saccades])
    corrective_s = onset_s + MIN_FIXATION_S
    in_time = corrective_s + MIN_FIXATION_S < np.append(onset_s[1:], trajectory.seconds)
    trajectory = split_fixations(trajectory, corrective_s[over & in_time].tolist())
    offsets = np.zeros((len(trajectory.saccades) + 1, 2))
    for index, planned in enumerate(trajectory.steps_rad):
        step = planned - offsets[index]
        offsets[index + 1] = step * min(1.0, MAX_AMPLITUDE_RAD / max(float(np.hypot(*step)), MIN_STEP_RAD)) - step
    return shift_fixations(trajectory, offsets)
