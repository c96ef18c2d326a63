"""Gaze goes to targets and back to what the model does: saccades by their law, the head along, the eyes converging.

The line of sight leaves at the target's onset in one saccade of the main sequence and lands on it; a target that moves
is then followed (smooth pursuit without delay). Vergence comes after at its own pace (a time constant of 0.2 s). The
head starts 30 ms later and takes what lies beyond a threshold of eccentricity, or all that eyes do not reach in comfort
(physiology.eye_head); the eyes make up for it. A saccade of the model's own just before is
left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.animation import sight
from talkingeyes.animation.course import LEAST_STEP_RAD, Course, lawful, turned, without
from talkingeyes.animation.targets import TargetTrack
from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMove, Saccade
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.vergence import TIME_CONSTANT_S

# The head's part in looking at things, the middle of what people do (Stahl 1999), and what eyes do in comfort.
HEAD_THRESHOLD_RAD, HEAD_GAIN, HEAD_LAG_S = float(np.radians(10.0)), 0.6, 0.030
COMFORT_RAD = np.radians([[-17.0, -17.0], [17.0, 11.0]])
HEAD_PURSUIT_S = 0.15
# Between targets closer than this gaze does not go back to what the model does.
LEAST_BACK_S = 0.25
# Nor do two saccades follow each other within this.
LEAST_INTERVAL_S = 0.15


@dataclass(frozen=True)
class _Leg:
    """From `start_s` on gaze is at a place, given at each frame of `part`; without one it is as the model has it."""

    start_s: float
    part: slice
    places_m: Float[ndarray, "N 3"] | None


@dataclass
class _Gaze:
    """Where both eyes look together, half of what they differ by, and the saccades: rewritten leg by leg."""

    together_rad: Float[ndarray, "T 2"]
    half_rad: Float[ndarray, "T 2"]
    saccades: list[Saccade]


def aimed(course: Course, track: TargetTrack) -> Course:
    """The course with gaze at the targets of a track while they last."""
    last_s = course.times_s[-1]
    track = replace(track, targets=tuple(each for each in track.targets if each.start_s <= last_s - LEAST_BACK_S))
    if not track.targets:
        return course
    course = without(course, _hasty(course, track))
    legs = _legs(course, track)
    if track.frame == "world":
        course = turned(course, _head_along_rad(course, legs))
    own = _Gaze(course.together_rad, (course.space_rad[:, 0] - course.space_rad[:, 1]) / 2.0, list(course.saccades))
    before = [each for each in own.saccades if each.onset_s < legs[0].start_s]
    gaze = _Gaze(own.together_rad.copy(), own.half_rad.copy(), before)
    for leg in legs:
        if leg.places_m is None:
            _go_back(gaze, own, leg, course)
        else:
            goal = sight.toward_rad(course.head[leg.part], leg.places_m, track.frame)
            _go(gaze, leg, course, goal.mean(axis=1), (goal[:, 0] - goal[:, 1]) / 2.0)
    space = np.stack([gaze.together_rad + gaze.half_rad, gaze.together_rad - gaze.half_rad], axis=1)
    return replace(course, space_rad=space, saccades=tuple(gaze.saccades))


def _legs(course: Course, track: TargetTrack) -> list[_Leg]:
    """Where gaze goes in turn; a target waits until the saccade that is under way has ended."""
    starts: list[tuple[float, str | None]] = []
    for number, target in enumerate(track.targets):
        starts.append((target.start_s, target.name))
        following = track.targets[number + 1].start_s if number + 1 < len(track.targets) else np.inf
        if target.end_s + LEAST_BACK_S < following:
            starts.append((target.end_s, None))
    onsets = [(max(start, _free_s(course, start)) if name else start, name) for start, name in starts]
    frames = [
        min(int(np.ceil(onset * course.fps - 1e-9)), len(course.head)) if onset < 1e9 else len(course.head)
        for onset, _ in onsets
    ]
    legs = []
    for (onset, name), first, stop in zip(onsets, frames, [*frames[1:], len(course.head)], strict=True):
        if first < stop:
            part = slice(first, stop)
            legs.append(_Leg(onset, part, None if name is None else track.place(name).at(course.times_s[part])))
    return legs


def _hasty(course: Course, track: TargetTrack) -> set[int]:
    """The model's saccades that come so shortly before a target that no second one could follow."""
    onsets = np.array([each.onset_s for each in course.saccades])
    spans = [np.searchsorted(onsets, [each.start_s - LEAST_INTERVAL_S, each.start_s]) for each in track.targets]
    return {index for first, stop in spans for index in range(first, stop)}


def _free_s(course: Course, time_s: float) -> float:
    """When the saccade that is under way at a time ends."""
    return max(
        (s.onset_s + s.duration_s for s in course.saccades if s.onset_s < time_s < s.onset_s + s.duration_s),
        default=0.0,
    )


def _go(
    gaze: _Gaze, leg: _Leg, course: Course, goal_rad: Float[ndarray, "N 2"], half_rad: Float[ndarray, "N 2"]
) -> None:
    """One saccade from where gaze is to a goal, which it then stays with; vergence follows."""
    times = course.times_s[leg.part]
    first = leg.part.start
    if first == 0:  # there from the start
        gaze.together_rad[leg.part], gaze.half_rad[leg.part] = goal_rad, half_rad
        return
    start, apart = gaze.together_rad[first - 1], gaze.half_rad[first - 1] - half_rad[0]
    duration = float(saccades.duration_s(float(np.hypot(*(goal_rad[0] - start)))))
    landing = np.array([np.interp(leg.start_s + duration, times, axis) for axis in goal_rad.T])
    if np.hypot(*(landing - start)) < LEAST_STEP_RAD:
        done = np.ones((len(times), 1))
    else:
        jump = lawful(leg.start_s, start, landing - start)
        done = saccades.progress((times - jump.onset_s) / jump.duration_s, jump.skew)[:, None]
        gaze.saccades.append(jump)
    gaze.together_rad[leg.part] = start + done * (goal_rad - start)
    gaze.half_rad[leg.part] = half_rad + np.exp(-(times - leg.start_s) / TIME_CONSTANT_S)[:, None] * apart


def _go_back(gaze: _Gaze, own: _Gaze, leg: _Leg, course: Course) -> None:
    """One saccade to where the model's gaze is when it lands, or when the model's own saccade meanwhile has ended."""
    first, times = leg.part.start, course.times_s[leg.part]
    step = own.together_rad[first] - gaze.together_rad[first - 1]
    lands_s = leg.start_s + float(saccades.duration_s(float(np.hypot(*step))))
    for each in own.saccades:
        if each.onset_s < lands_s + LEAST_INTERVAL_S and lands_s < each.onset_s + each.duration_s:
            lands_s = each.onset_s + each.duration_s
    landed = min(int(np.ceil(lands_s * course.fps)) - first, len(times) - 1)
    goal = own.together_rad[leg.part].copy()
    goal[:landed] = goal[landed]
    _go(gaze, leg, course, goal, own.half_rad[leg.part])
    stop_s = leg.part.stop / course.fps
    gaze.saccades += [each for each in own.saccades if lands_s <= each.onset_s < stop_s]


def _head_along_rad(course: Course, legs: list[_Leg]) -> Float[ndarray, "T 2"]:
    """How far (yaw, pitch) the head turns towards each target, and back, over what the model's head does."""
    pointing = rotation.angles_of_direction(rotation.directions(course.head))
    total = np.zeros((len(course.head), 2))
    moves: list[HeadMove] = []
    now = np.zeros(2)
    for leg in legs:
        level = _head_part_rad(leg.places_m, pointing[leg.part].mean(axis=0))
        step = level[0] - now
        if (size := float(np.hypot(*step))) > LEAST_STEP_RAD:
            onset = leg.start_s + HEAD_LAG_S if leg.part.start else -1.0
            moves.append(HeadMove(onset, float(eye_head.head_duration_s(size)), (step[0], step[1], 0.0)))
        followed = gaussian_filter1d(level - level[0], HEAD_PURSUIT_S * course.fps, axis=0, mode="nearest")
        followed -= followed[0]
        total[leg.part] += followed
        total[leg.part.stop :] += followed[-1]
        now = level[0] + followed[-1]
    return np.asarray(total + eye_head.head_path(moves, course.times_s)[:, :2])


def _head_part_rad(places_m: Float[ndarray, "N 3"] | None, pointing_rad: Float[ndarray, " 2"]) -> Float[ndarray, "N 2"]:
    if places_m is None:
        return np.zeros((1, 2))
    angles = rotation.angles_of_direction(places_m / np.linalg.norm(places_m, axis=-1, keepdims=True))
    beside = angles - pointing_rad
    left = beside - eye_head.head_contribution(beside, HEAD_THRESHOLD_RAD, HEAD_GAIN)
    return np.asarray(beside - np.clip(left, *COMFORT_RAD))
