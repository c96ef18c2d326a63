"""Habits of a person are imposed on what a model gives; they are measured by `fitting.manner`.

Means and ranges by a shift and a scale, the rate of saccades by leaving out the smallest or by cutting the longest
fixations. What is done when stays the model's. Head: rotation vectors; gaze: (yaw, pitch) in space; radians.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.gaze_trajectory import (
    GazeTrajectory,
    fixations,
    remove_saccades,
    scale_gaze,
    shift_fixations,
    split_fixations,
)
from talkingeyes.animation.motion_resampling import resample_motion
from talkingeyes.core.motion import Events, Motion
from talkingeyes.fitting.motion_style import MotionStyle, measure_style
from talkingeyes.physiology import saccades

# No more than so many times larger than the model's: a still clip has no motion to scale up.
MAX_GAIN = 8.0
MIN_RANGE_RAD = float(np.radians(0.05))
MEASURED_FPS = 25.0
MIN_FIXATION_S = 0.2
SCAN_DEG = (1.2, 6.0)


def measure_clip_style(clip: Motion) -> MotionStyle:
    """The habits in a reference clip of any frame rate; saccades are counted at 25 a second, as the model has them."""
    return measure_style(resample_motion(clip, Events(), MEASURED_FPS))


def apply_style(trajectory: GazeTrajectory, motion_style: MotionStyle, seeds: Sequence[int]) -> GazeTrajectory:
    """The course with a person's mean pose, ranges and rate of saccades."""
    trajectory = _set_saccade_rate(trajectory, motion_style.saccades_per_min, seeds)
    together, centre = trajectory.cyclopean_rad, trajectory.cyclopean_rad.mean(axis=0)
    gain = _gain(np.array(motion_style.gaze_sd_rad), together.std(axis=0))
    trajectory = scale_gaze(trajectory, centre, gain, np.array(motion_style.gaze_mean_rad))
    mean = trajectory.head.mean(axis=0)
    turn = _gain(np.array(motion_style.head_sd_rad), trajectory.head.std(axis=0))
    return replace(trajectory, head=np.array(motion_style.head_mean_rad) + turn * (trajectory.head - mean))


def _gain(wanted: Float[ndarray, " C"], had: Float[ndarray, " C"]) -> Float[ndarray, " C"]:
    return np.asarray(np.clip(wanted / np.maximum(had, MIN_RANGE_RAD), 0.0, MAX_GAIN))


def _set_saccade_rate(trajectory: GazeTrajectory, per_min: float, seeds: Sequence[int]) -> GazeTrajectory:
    """As many saccades a minute: the smallest are left out, the next one takes their step; or more look about."""
    wanted = round(per_min * trajectory.seconds / 60.0)
    return (
        _remove_smallest(trajectory, wanted)
        if wanted < len(trajectory.saccades)
        else _add_small_saccades(trajectory, wanted, seeds)
    )


def _remove_smallest(trajectory: GazeTrajectory, wanted: int) -> GazeTrajectory:
    return remove_saccades(
        trajectory,
        np.argsort(np.hypot(*trajectory.steps_rad.T), kind="stable")[: len(trajectory.saccades) - wanted].tolist(),
    )


def _add_small_saccades(trajectory: GazeTrajectory, wanted: int, seeds: Sequence[int]) -> GazeTrajectory:
    """The longest fixations are cut, in the middle or thereabouts, by a small saccade, as long as one can be."""
    rng = np.random.default_rng(seeds)
    found = fixations(trajectory, trajectory.cyclopean_rad)
    longest = [(float(start - end), float(start)) for start, end in zip(found.start_s, found.end_s, strict=True)]
    heapq.heapify(longest)
    onsets: set[float] = set()
    while len(trajectory.saccades) + len(onsets) < wanted and -longest[0][0] >= 2 * MIN_FIXATION_S:
        length, start = heapq.heappop(longest)
        onset = start - float(rng.uniform(0.35, 0.65)) * length
        onsets.add(onset)
        heapq.heappush(longest, (start - onset, start))
        heapq.heappush(longest, (length + onset - start, onset))
    new = split_fixations(trajectory, sorted(onsets))
    offsets = np.zeros((len(new.saccades) + 1, 2))
    for index, each in enumerate(new.saccades):
        if each.onset_s in onsets:
            size = saccades.sample_amplitudes_rad(1, rng, *SCAN_DEG)
            offsets[index + 1] = size * saccades.sample_directions(1, rng)[0]
    return shift_fixations(new, offsets)
