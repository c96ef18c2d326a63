"""Style transfer: impose a person's motion statistics (`fitting/motion_style.py`) on a trajectory.

Mean pose and standard deviation by shift and scale; the rate of saccades by removing the smallest ones, or by splitting
the longest fixations. The timing of motion stays the model's. Head: rotation vectors; gaze: (yaw, pitch) in space;
radians.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import (
    GazeTrajectory,
    fixations,
    remove_saccades,
    scale_gaze,
    shift_fixations,
    split_fixations,
)
from talkingeyes.physiology import saccades

STYLE_STREAM = 1
# Upper limit of the scale: a still clip has no motion to scale up.
MAX_GAIN = 8.0
MIN_RANGE_RAD = float(np.radians(0.05))
MIN_FIXATION_S = 0.2
SCAN_DEG = (1.2, 6.0)


def apply_style(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Give the trajectory the mean pose, the ranges and the rate of saccades of the style, if there is one."""
    motion_style = context.motion_style
    if motion_style is None:
        return trajectory
    trajectory = _set_saccade_rate(trajectory, motion_style.saccades_per_min, context.stream(STYLE_STREAM))
    together, centre = trajectory.cyclopean_rad, trajectory.cyclopean_rad.mean(axis=0)
    gain = _gain(np.array(motion_style.gaze_sd_rad), together.std(axis=0))
    trajectory = scale_gaze(trajectory, centre, gain, np.array(motion_style.gaze_mean_rad))
    mean = trajectory.head.mean(axis=0)
    turn = _gain(np.array(motion_style.head_sd_rad), trajectory.head.std(axis=0))
    return replace(trajectory, head=np.array(motion_style.head_mean_rad) + turn * (trajectory.head - mean))


def _gain(wanted: Float[ndarray, " C"], had: Float[ndarray, " C"]) -> Float[ndarray, " C"]:
    return np.asarray(np.clip(wanted / np.maximum(had, MIN_RANGE_RAD), 0.0, MAX_GAIN))


def _set_saccade_rate(trajectory: GazeTrajectory, per_min: float, seeds: Sequence[int]) -> GazeTrajectory:
    """Remove the smallest saccades (the next one takes their step), or add small ones, to reach the rate."""
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
    """Split the longest fixations near their middle with small saccades, while both parts stay long enough."""
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
