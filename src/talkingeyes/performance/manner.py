"""Habits of a person, measured: where head and gaze rest, how far they go, how often eyes jump and blink.

They are measured in motions of a speaker of the corpus (and kept with the model), or in a reference clip, and imposed
on what the model gives: means and ranges by a shift and a scale, the rate of saccades by leaving out the smallest or by
cutting the longest fixations. What is said when stays the model's. Head: rotation vectors; gaze: (yaw, pitch) in space;
radians.
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import TypeAdapter

from talkingeyes import rotation
from talkingeyes.errors import InputError
from talkingeyes.motion import Events, Motion
from talkingeyes.performance.course import Course, fixations, reaimed, scaled, split
from talkingeyes.performance.events import find_saccades
from talkingeyes.performance.retime import retimed
from talkingeyes.physiology import saccades

SPEAKERS_FILE = "speakers.json"
# No more than so many times larger or smaller than the model's: a still clip has no motion to scale up.
MOST_GAIN = 4.0
LEAST_RANGE_RAD = float(np.radians(0.05))
MEASURED_FPS = 25.0
SHORTEST_S = 1.0
LEAST_FIXATION_S = 0.2
SCAN_DEG = (1.2, 6.0)


@dataclass(frozen=True)
class Manner:
    """What is measured: means, standard deviations about them, rates a minute."""

    head_mean_rad: tuple[float, float, float]
    head_sd_rad: tuple[float, float, float]
    gaze_mean_rad: tuple[float, float]
    gaze_sd_rad: tuple[float, float]
    saccades_per_min: float
    blinks_per_min: float


def measured(motion: Motion, blinks_per_min: float) -> Manner:
    """The habits in one clip. Saccades are counted at 25 frames a second, as the model has them."""
    if motion.seconds < SHORTEST_S:
        raise InputError(f"style: a clip should last at least {SHORTEST_S:g} s, got {motion.seconds:.2f} s")
    even = retimed(motion, Events(), MEASURED_FPS)
    space = rotation.gaze_in_space(even.head, even.gaze)
    found = find_saccades(space.mean(axis=1), MEASURED_FPS)
    return Manner(
        head_mean_rad=_triple(even.head.mean(axis=0)),
        head_sd_rad=_triple(even.head.std(axis=0)),
        gaze_mean_rad=_pair(space.mean(axis=(0, 1))),
        gaze_sd_rad=_pair(space.mean(axis=1).std(axis=0)),
        saccades_per_min=60.0 * len(found) / even.seconds,
        blinks_per_min=blinks_per_min,
    )


def pooled(manners: Sequence[Manner], seconds: Sequence[float]) -> Manner:
    """The habits of a person over clips: means weighted by their length, ranges those within clips."""
    weight = np.asarray(seconds) / np.sum(seconds)
    mean = {name: weight @ np.array([getattr(each, name) for each in manners]) for name in asdict(manners[0])}
    return Manner(
        _triple(mean["head_mean_rad"]),
        _triple(mean["head_sd_rad"]),
        _pair(mean["gaze_mean_rad"]),
        _pair(mean["gaze_sd_rad"]),
        float(mean["saccades_per_min"]),
        float(mean["blinks_per_min"]),
    )


def save_speakers(path: Path, speakers: Mapping[str, Manner]) -> None:
    """Keep the habits of speakers, by name, with a model."""
    path.write_text(json.dumps({name: asdict(manner) for name, manner in sorted(speakers.items())}, indent=1))


def load_speakers(path: Path) -> dict[str, Manner]:
    """Those kept with a model; none if it has no such file. Raises InputError if the file is damaged."""
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text())
        return {name: TypeAdapter(Manner).validate_python(values) for name, values in content.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: should hold habits of speakers, got {error!r}") from None


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
    steps = np.array([np.subtract(each.end_rad, each.start_rad) for each in course.saccades]).reshape(-1, 2)
    gone = np.argsort(np.hypot(*steps.T), kind="stable")[: len(steps) - wanted]
    offsets = np.zeros((len(steps) + 1, 2))
    for index in sorted(gone):
        # The fixation after a saccade that is left out stays where the one before it was.
        offsets[index + 1] = offsets[index] - steps[index]
    return reaimed(course, offsets)


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


def _triple(values: Float[ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in values)
    return x, y, z


def _pair(values: Float[ndarray, " 2"]) -> tuple[float, float]:
    yaw, pitch = (float(each) for each in values)
    return yaw, pitch
