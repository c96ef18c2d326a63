"""A performance before it is rendered: head and gaze in space at the model's rate, and the saccades in them.

Directing changes a course, never frames of eyes: gaze is a smooth part and a staircase of saccades; what is re-aimed
are the steps between fixations. A saccade that becomes larger takes as long as the law says (physiology.saccades), so
it plays at any frame rate as a real one. Angles are (yaw, pitch) in radians, times seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.events import staircase
from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMove, Saccade
from talkingeyes.physiology import eye_head, saccades

LEAST_STEP_RAD = 1e-6


@dataclass(frozen=True)
class Course:
    """T frames at the model's rate: the head, where each eye's optical axis points in space, and the saccades."""

    fps: float
    head: Float[ndarray, "T 3"]
    space_rad: Float[ndarray, "T 2 2"]
    saccades: tuple[Saccade, ...]

    @property
    def times_s(self) -> Float[ndarray, " T"]:
        """When each frame is."""
        return np.arange(len(self.head)) / self.fps

    @property
    def seconds(self) -> float:
        """How long it is."""
        return len(self.head) / self.fps

    @property
    def together_rad(self) -> Float[ndarray, "T 2"]:
        """Where both eyes look together, as the saccades have it: the mean of their angles."""
        return np.asarray(self.space_rad.mean(axis=1))

    @property
    def steps_rad(self) -> Float[ndarray, "N 2"]:
        """How far each saccade goes."""
        return np.array([np.subtract(each.end_rad, each.start_rad) for each in self.saccades]).reshape(-1, 2)

    @property
    def smooth_rad(self) -> Float[ndarray, "T 2 2"]:
        """Gaze without its saccades: drift, and what the eyes differ by."""
        return np.asarray(self.space_rad - staircase(self.saccades, self.times_s)[:, None])


@dataclass(frozen=True)
class Fixations:
    """The stretches between K - 1 saccades: when, and where gaze is on average."""

    start_s: Float[ndarray, " K"]
    end_s: Float[ndarray, " K"]
    place_rad: Float[ndarray, "K 2"]


def fixations(course: Course, gaze_rad: Float[ndarray, "T 2"]) -> Fixations:
    """Where `gaze_rad` (as seen from anywhere, such as from the listener) is in each fixation of a course."""
    ends = np.array([(each.onset_s, each.onset_s + each.duration_s) for each in course.saccades]).reshape(-1, 2)
    start = np.concatenate([[0.0], ends[:, 1]])
    end = np.maximum(np.concatenate([ends[:, 0], [course.seconds]]), start)
    last = len(course.head) - 1
    first_frame = np.clip(np.ceil(start * course.fps - 1e-9).astype(int), 0, last)
    stop_frame = np.maximum(np.clip(np.floor(end * course.fps + 1e-9).astype(int) + 1, 0, last + 1), first_frame + 1)
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(gaze_rad, axis=0)])
    place = (summed[stop_frame] - summed[first_frame]) / (stop_frame - first_frame)[:, None]
    return Fixations(start, end, place)


def reaimed(course: Course, offsets_rad: Float[ndarray, "K 2"]) -> Course:
    """The course with each fixation moved by an offset; the saccades between take what their offsets differ by."""
    smooth = course.smooth_rad + offsets_rad[0]
    return with_steps(course, smooth, course.steps_rad + np.diff(offsets_rad, axis=0))


def without(course: Course, indices: Iterable[int]) -> Course:
    """The course without some of its saccades: gaze stays where it was, and the next saccade takes their steps too."""
    steps = course.steps_rad
    offsets = np.zeros((len(steps) + 1, 2))
    for index in sorted(indices):
        offsets[index + 1] = offsets[index] - steps[index]
    return reaimed(course, offsets)


def with_steps(course: Course, smooth_rad: Float[ndarray, "T 2 2"], steps_rad: Float[ndarray, "N 2"]) -> Course:
    """A course of this smooth part and steps at the saccades' onsets; a step of nothing is no saccade any more."""
    onset_s = np.array([each.onset_s for each in course.saccades])
    drift = smooth_rad.mean(axis=1)
    start = np.stack([np.interp(onset_s, course.times_s, axis) for axis in drift.T], axis=-1)
    start = start + np.cumsum(steps_rad, axis=0) - steps_rad
    jumps = tuple(
        lawful(float(onset), place, step)
        for onset, place, step in zip(onset_s, start, steps_rad, strict=True)
        if np.hypot(*step) > LEAST_STEP_RAD
    )
    space = smooth_rad + staircase(jumps, course.times_s)[:, None]
    return replace(course, space_rad=space, saccades=jumps)


def lawful(onset_s: float, start_rad: Float[ndarray, " 2"], step_rad: Float[ndarray, " 2"]) -> Saccade:
    """A saccade of the main sequence, without jitter."""
    size = float(np.hypot(*step_rad))
    (yaw, pitch), (to_yaw, to_pitch) = start_rad.tolist(), (start_rad + step_rad).tolist()
    duration, skew = float(saccades.duration_s(size)), float(saccades.skew(size))
    return Saccade(onset_s, duration, (yaw, pitch), (to_yaw, to_pitch), skew)


def split(course: Course, onsets_s: Sequence[float]) -> Course:
    """The course with steps of nothing at further times, so that what follows them can be aimed elsewhere."""
    new = [lawful(onset, np.zeros(2), np.zeros(2)) for onset in onsets_s]
    return replace(course, saccades=tuple(sorted([*course.saccades, *new], key=lambda each: each.onset_s)))


def scaled(
    course: Course,
    centre_rad: Float[ndarray, " 2"],
    gain: Float[ndarray, " 2"],
    new_centre_rad: Float[ndarray, " 2"],
) -> Course:
    """Gaze as far from a new centre as it was from the old one, times a gain for yaw and pitch; vergence stays."""
    smooth = course.smooth_rad
    drift = smooth.mean(axis=1)
    moved = new_centre_rad + gain * (drift - centre_rad)
    return with_steps(course, smooth - drift[:, None] + moved[:, None], course.steps_rad * gain)


def turned(course: Course, along_rad: Float[ndarray, "T 2"]) -> Course:
    """The head turned further by (yaw, pitch); gaze in space stays."""
    extra = np.stack([-along_rad[:, 1], along_rad[:, 0], np.zeros(len(along_rad))], axis=-1)
    return replace(course, head=course.head + extra)


def taken_along(
    course: Course,
    onsets_s: Float[ndarray, " K"],
    eccentricity_rad: Float[ndarray, "K 2"],
    threshold_rad: float,
    gain: float,
) -> Course:
    """The head turned further by its part in where gaze is from each onset on (physiology.eye_head)."""
    levels = eye_head.head_contribution(eccentricity_rad, threshold_rad, gain)
    moves = []
    for onset, step in zip(onsets_s, np.diff(levels, axis=0, prepend=np.zeros((1, 2))), strict=True):
        if size := float(np.hypot(*step)):
            lag = eye_head.ONSET_LAG_S[0] if onset else -1.0
            moves.append(HeadMove(float(onset) + lag, float(eye_head.head_duration_s(size)), (step[0], step[1], 0.0)))
    return turned(course, eye_head.head_path(moves, course.times_s)[:, :2])


def within_reach(course: Course, own: Course) -> Course:
    """Gaze no further from the head than eyes turn, where it is not the model's own."""
    moved = np.abs(course.space_rad - own.space_rad).max(axis=(1, 2)) + np.abs(course.head - own.head).max(axis=1)
    changed = np.flatnonzero(moved > LEAST_STEP_RAD)
    head = course.head[changed]
    angles = rotation.angles_of_gaze(rotation.eye_in_head(head, course.space_rad[changed]))
    within = eye_head.within_limits(angles)
    beyond = (within != angles).any(axis=(-2, -1))
    eyes = rotation.gaze_of_angles(within[beyond])
    space = course.space_rad.copy()
    space[changed[beyond]] = rotation.gaze_in_space(head[beyond], eyes)
    return replace(course, space_rad=space)
