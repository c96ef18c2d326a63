"""Head contribution: the head turns with gaze that stays far to a side of it.

A few gaze shifts in a hundred are large, and a head model that does not see gaze leaves them to the eyes alone. People
turn the head by 0.3 to 0.9 of what lies beyond 5 to 20 degrees (Stahl 1999); the middle of that is used.
"""

from __future__ import annotations

import numpy as np

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, add_head_turns, fixations
from talkingeyes.core import rotation

# Values without a source are choices of this project.
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(12.5)), 0.6
MIN_FIXATION_S = 0.5  # a shorter glance is over before the head arrives


def add_head_contribution(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Turn the head towards long eccentric fixations; gaze in space stays. Off with `no_postprocessing`."""
    if context.controls.no_postprocessing:
        return trajectory
    pointing = rotation.direction_to_angles(rotation.rotvec_to_direction(trajectory.head))
    found = fixations(trajectory, trajectory.cyclopean_rad - pointing)
    long = found.end_s - found.start_s >= MIN_FIXATION_S
    return add_head_turns(trajectory, found.start_s[long], found.location_rad[long], HEAD_THRESHOLD_RAD, HEAD_GAIN)
