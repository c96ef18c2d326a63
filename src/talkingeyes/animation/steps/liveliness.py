"""Liveliness: the amplitude of head motion and of gaze about their means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, scale_gaze


def apply_liveliness(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Scale head and gaze about the centre of the context, else about their mean and median in the trajectory."""
    liveliness, centre = context.controls.liveliness, context.centre
    if liveliness.gaze != 1.0:
        gaze_centre = centre.gaze_rad if centre else np.median(trajectory.cyclopean_rad, axis=0)
        trajectory = scale_gaze(trajectory, gaze_centre, np.full(2, liveliness.gaze), gaze_centre)
    if liveliness.head != 1.0:
        mean = centre.head if centre else trajectory.head.mean(axis=0)
        trajectory = replace(trajectory, head=mean + liveliness.head * (trajectory.head - mean))
    return trajectory
