"""Head motion between the events of a point process of speed minima (point_process.py), in numpy."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.interpolate import CubicHermiteSpline

# Bins sampled beyond the end, so that the last frames lie between two events.
EXTRA_BINS = 12
# Fraction of the mean velocity of the two adjacent segments that remains at a speed minimum. With 1, or with a spline,
# heads are smoother than those of people (velocity above 1.8 Hz, slope of the spectrum). Chosen on val (docs/log.md).
VELOCITY_RETENTION = 0.4


def interpolate_poses(
    event: Bool[ndarray, "B N"], location: Float[ndarray, "B N 3"], bin_frames: int
) -> Float[ndarray, "B T 3"]:
    """Frames of N bins: Hermite cubics between events. The first bin must hold an event.

    `location` holds the pose since the last event. Events lie at the centres of their bins: at random times, two could
    come close together, and their difference would be a jerk. All rows are concatenated into one curve, because
    building a curve costs more than evaluating it.
    """
    event = event.copy()
    event[:, -1] = True  # the last bin repeats the last pose
    row, index = np.nonzero(event)
    frames = event.shape[1] * bin_frames
    knot, pose = row * frames + index * bin_frames + (bin_frames - 1) / 2, location[row, index].astype(float)
    velocity = np.zeros_like(pose)
    velocity[1:-1] = VELOCITY_RETENTION * (pose[2:] - pose[:-2]) / (knot[2:] - knot[:-2])[:, None]
    velocity[(index == 0) | (index == event.shape[1] - 1)] = 0  # a row starts and ends at rest
    time = np.arange(frames).clip((bin_frames - 1) / 2, frames - 1 - (bin_frames - 1) / 2)
    curve = CubicHermiteSpline(knot, pose, velocity)
    return np.asarray(curve(np.arange(len(event))[:, None] * frames + time))
