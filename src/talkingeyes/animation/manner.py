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

from talkingeyes.animation.course import Course, fixations, reaimed, scaled, split, without
from talkingeyes.animation.retime import retimed
from talkingeyes.core.motion import Events, Motion
from talkingeyes.fitting.manner import Manner, measured
from talkingeyes.physiology import saccades

# No more than so many times larger than the model's: a still clip has no motion to scale up.
MOST_GAIN = 8.0
LEAST_RANGE_RAD = float(np.radians(0.05))
MEASURED_FPS = 25.0
LEAST_FIXATION_S = 0.2
SCAN_DEG = (1.2, 6.0)


def manner_of(clip: Motion) -> Manner:
    """The habits in a reference clip of any frame rate; saccades are counted at 25 a second, as the model has them."""
    return measured(retimed(clip, Events(), MEASURED_FPS))


def in_manner(course: Course, manner: Manner, seeds: Sequence[int]) -> Course:
    """The course with a person's mean pose, ranges and rate of saccades."""
    course = _at_rate(course, manner.saccades_per_min, seeds)
    together, centre = course.together_rad, course.together_rad.mean(axis=0)
    gain = _gain(np.array(manner.gaze_sd_rad), together.std(axis=0))
    course = scaled(course, centre, gain, np.array(manner.gaze_mean_rad))
    mean = course.head.mean(axis=0)
    turn = _gain(np.array(manner.head_sd_rad), course.head.std(axis=0))
    return replace(course, head=np.array(manner.head_mean_rad) + turn * (course.head - mean))


def _gain(wanted: Float[ndarray, " C"], had: Float[ndarray, " C"]) -> Float[ndarray, " C"]:
    return np.asarray(np.clip(wanted / np.maximum(had, LEAST_RANGE_RAD), 0.0, MOST_GAIN))


def _at_rate(course: Course, per_min: float, seeds: Sequence[int]) -> Course:
    """As many saccades a minute: the smallest are left out, the next one takes their step; or more look about."""
    wanted = round(per_min * course.seconds / 60.0)
    return _with_fewer(course, wanted) if wanted < len(course.saccades) else _with_more(course, wanted, seeds)


def _with_fewer(course: Course, wanted: int) -> Course:
    return without(
        course, np.argsort(np.hypot(*course.steps_rad.T), kind="stable")[: len(course.saccades) - wanted].tolist()
    )


def _with_more(course: Course, wanted: int, seeds: Sequence[int]) -> Course:
    """The longest fixations are cut, in the middle or thereabouts, by a small saccade, as long as one can be."""
    random = np.random.default_rng(seeds)
    found = fixations(course, course.together_rad)
    longest = [(float(start - end), float(start)) for start, end in zip(found.start_s, found.end_s, strict=True)]
    heapq.heapify(longest)
    onsets: set[float] = set()
    while len(course.saccades) + len(onsets) < wanted and -longest[0][0] >= 2 * LEAST_FIXATION_S:
        length, start = heapq.heappop(longest)
        onset = start - float(random.uniform(0.35, 0.65)) * length
        onsets.add(onset)
        heapq.heappush(longest, (start - onset, start))
        heapq.heappush(longest, (length + onset - start, onset))
    new = split(course, sorted(onsets))
    offsets = np.zeros((len(new.saccades) + 1, 2))
    for index, each in enumerate(new.saccades):
        if each.onset_s in onsets:
            size = saccades.draw_amplitudes_rad(1, random, *SCAN_DEG)
            offsets[index + 1] = size * saccades.draw_directions(1, random)[0]
    return reaimed(new, offsets)
