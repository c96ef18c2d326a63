"""What eyes and heads do that frames of fitted motion cannot teach: intrusions, and the head's part in large shifts.

Video at 25 frames a second shows no saccade below a degree or so, and a few shifts in a hundred go far: a model that
learnt from it makes none of the first, and its head, which knows nothing of gaze, leaves the second to the eyes alone.
Both have their laws (Abadi & Gowen 2004; physiology.eye_head), and so has how large a saccade in talk can be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.gaze_trajectory import (
    MIN_STEP_RAD,
    GazeTrajectory,
    add_head_turns,
    fixations,
    shift_fixations,
    split_fixations,
)
from talkingeyes.core import rotation
from talkingeyes.physiology import saccades

MAX_AMPLITUDE_RAD = float(np.radians(saccades.MAX_TALKING_AMPLITUDE_DEG))
MIN_FIXATION_S = 0.2
# Fixation is interrupted by a small step to a side and, soon after, one back. Of 50 healthy people (Abadi & Gowen
# 2004): so many a second; amplitude and time until the step back as (mean, SD), and their ranges. None was vertical.
INTRUSIONS_PER_S = 18.0 / 60.0
INTRUSION_DEG, INTRUSION_RANGE_DEG = (0.6, 0.5), (0.1, 4.1)
INTRUSION_S, INTRUSION_RANGE_S = (0.225, 0.150), (0.04, 0.87)
MIN_FITTED_DEG = 1.2  # smaller ones a fit does not see
# The middle of what people's heads do (Stahl 1999: from 5 to 20 degrees on, .3 to .9 of what is beyond).
HEAD_THRESHOLD_RAD, HEAD_GAIN = float(np.radians(12.5)), 0.6
MIN_HEAD_FIXATION_S = 0.5  # before the head is there, the eyes are back


def limit_amplitude(trajectory: GazeTrajectory) -> GazeTrajectory:
    """The course with no saccade larger than talk has them (Lee, Badler & Badler 2002): one that is falls short, and
    a second one makes up for it, unless the next is there before."""
    over = np.hypot(*trajectory.steps_rad.T) > MAX_AMPLITUDE_RAD
    if not over.any():
        return trajectory
    onset_s = np.array([each.onset_s for each in trajectory.saccades])
    second_s = onset_s + MIN_FIXATION_S
    in_time = second_s + MIN_FIXATION_S < np.append(onset_s[1:], trajectory.seconds)
    trajectory = split_fixations(trajectory, second_s[over & in_time].tolist())
    offsets = np.zeros((len(trajectory.saccades) + 1, 2))
    for index, planned in enumerate(trajectory.steps_rad):
        step = planned - offsets[index]
        offsets[index + 1] = step * min(1.0, MAX_AMPLITUDE_RAD / max(float(np.hypot(*step)), MIN_STEP_RAD)) - step
    return shift_fixations(trajectory, offsets)


def add_head_contribution(trajectory: GazeTrajectory) -> GazeTrajectory:
    """The course with the head taken along where gaze is far off to a side of it, but for glances."""
    pointing = rotation.direction_to_angles(rotation.rotvec_to_direction(trajectory.head))
    found = fixations(trajectory, trajectory.cyclopean_rad - pointing)
    long = found.end_s - found.start_s >= MIN_HEAD_FIXATION_S
    return add_head_turns(trajectory, found.start_s[long], found.location_rad[long], HEAD_THRESHOLD_RAD, HEAD_GAIN)


def add_saccadic_intrusions(trajectory: GazeTrajectory, gain: float, seeds: Sequence[int]) -> GazeTrajectory:
    """The course with saccadic intrusions in its fixations, times a gain: steps to a side that are soon taken back.

    Those that a fit sees are the model's to learn. Gaze that never moves is no fixation and stays still.
    """
    rng = np.random.default_rng(seeds)
    found = fixations(trajectory, trajectory.cyclopean_rad)
    room_s = np.maximum(found.end_s - found.start_s - 2.0 * MIN_FIXATION_S - INTRUSION_S[0], 0.0)
    count = rng.poisson(INTRUSIONS_PER_S * room_s.sum())
    if not (trajectory.saccades and count and gain):
        return trajectory
    within = rng.choice(len(room_s), count, p=room_s / room_s.sum())
    out_s = np.sort(found.start_s[within] + MIN_FIXATION_S + rng.random(count) * room_s[within])
    last_s = found.end_s[np.searchsorted(found.start_s, out_s) - 1] - MIN_FIXATION_S
    back_s = np.minimum(out_s + _log_normal(INTRUSION_S, INTRUSION_RANGE_S, count, rng), last_s)
    free_s = np.concatenate([[-np.inf], np.maximum.accumulate(back_s)[:-1]]) + MIN_FIXATION_S
    size_deg = _log_normal(INTRUSION_DEG, INTRUSION_RANGE_DEG, count, rng) * rng.choice([-1.0, 1.0], count)
    taken = (out_s >= free_s) & (np.abs(size_deg) < MIN_FITTED_DEG)
    new = split_fixations(trajectory, [*out_s[taken], *back_s[taken]])
    out = np.isin([each.onset_s for each in new.saccades], out_s[taken])
    offsets = np.zeros((len(new.saccades) + 1, 2))
    offsets[1:][out, 0] = gain * np.radians(size_deg[taken])
    return shift_fixations(new, offsets)


def _log_normal(
    mean_and_sd: tuple[float, float], limits: tuple[float, float], count: int, rng: np.random.Generator
) -> Float[ndarray, " N"]:
    """Draws of a log-normal law of this mean and standard deviation, within limits."""
    mean, sd = mean_and_sd
    variance = np.log1p((sd / mean) ** 2)
    return np.clip(rng.lognormal(np.log(mean) - variance / 2.0, np.sqrt(variance), count), *limits)
