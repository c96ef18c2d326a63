"""Target following: gaze goes to the targets of a track, and back to the model's gaze between them.

At the onset of a target the line of sight makes one saccade of the main sequence that lands on it; a moving target is
then followed by smooth pursuit without delay. Vergence follows with a time constant of 0.2 s. The head starts 30 ms
later and takes what lies beyond a threshold of eccentricity, or what exceeds the comfortable range of the eyes
(`physiology/eye_head.py`); the eyes compensate for the head. The model's saccades just before a target are removed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import (
    MIN_STEP_RAD,
    GazeTrajectory,
    add_head_rotation,
    main_sequence_saccade,
    remove_saccades,
)
from talkingeyes.animation.targets import TargetTrack
from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMovement, Saccade
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.vergence import TIME_CONSTANT_S

# Head contribution, the middle of the range of people (Stahl 1999), and the comfortable range of the eyes.
HEAD_THRESHOLD_RAD, HEAD_GAIN, HEAD_LAG_S = float(np.radians(10.0)), 0.6, 0.030
COMFORT_RANGE_RAD = np.radians([[-17.0, -17.0], [17.0, 11.0]])
HEAD_PURSUIT_S = 0.15
# Gaze does not return to the model between targets that are closer than this.
MIN_RETURN_S = 0.25
# Minimum interval of two saccades.
MIN_INTERVAL_S = 0.15


@dataclass(frozen=True)
class _Segment:
    """From `start_s` on gaze is at `targets`, homogeneous coordinates a frame of `part`; None: at the model's gaze."""

    start_s: float
    part: slice
    targets: Float[ndarray, "N 4"] | None


@dataclass
class _Gaze:
    """Cyclopean gaze, half of the vergence, and the saccades; rewritten segment by segment."""

    cyclopean_rad: Float[ndarray, "T 2"]
    half_vergence_rad: Float[ndarray, "T 2"]
    saccades: list[Saccade]


def apply_targets(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Direct gaze to the targets of the controls while they last."""
    track = context.controls.targets
    if track is None:
        return trajectory
    last_s = trajectory.times_s[-1]
    track = replace(track, targets=tuple(each for each in track.targets if each.start_s <= last_s - MIN_RETURN_S))
    if not track.targets:
        return trajectory
    trajectory = remove_saccades(trajectory, _too_close(trajectory, track))
    segments = _segments(trajectory, track)
    if track.frame == "world":
        trajectory = add_head_rotation(trajectory, _head_rotation_rad(trajectory, segments))
    own = _Gaze(
        trajectory.cyclopean_rad,
        (trajectory.gaze_in_space_rad[:, 0] - trajectory.gaze_in_space_rad[:, 1]) / 2.0,
        list(trajectory.saccades),
    )
    before = [each for each in own.saccades if each.onset_s < segments[0].start_s]
    gaze = _Gaze(own.cyclopean_rad.copy(), own.half_vergence_rad.copy(), before)
    for segment in segments:
        if segment.targets is None:
            _return_to_model(gaze, own, segment, trajectory)
        else:
            goal = line_of_sight.optical_axes_rad(trajectory.head[segment.part], segment.targets, track.frame)
            _saccade_to(gaze, segment, trajectory, goal.mean(axis=1), (goal[:, 0] - goal[:, 1]) / 2.0)
    space = np.stack([gaze.cyclopean_rad + gaze.half_vergence_rad, gaze.cyclopean_rad - gaze.half_vergence_rad], axis=1)
    return replace(trajectory, gaze_in_space_rad=space, saccades=tuple(gaze.saccades))


def _segments(trajectory: GazeTrajectory, track: TargetTrack) -> list[_Segment]:
    """The segments in order of time; a target starts after a saccade that is under way at its onset."""
    starts: list[tuple[float, str | None]] = []
    for number, target in enumerate(track.targets):
        starts.append((target.start_s, target.name))
        following = track.targets[number + 1].start_s if number + 1 < len(track.targets) else np.inf
        if target.end_s + MIN_RETURN_S < following:
            starts.append((target.end_s, None))
    onsets = [(max(start, _saccade_end_s(trajectory, start)) if name else start, name) for start, name in starts]
    frames = [
        min(int(np.ceil(onset * trajectory.fps - 1e-9)), len(trajectory.head)) if onset < 1e9 else len(trajectory.head)
        for onset, _ in onsets
    ]
    segments = []
    for (onset, name), first, stop in zip(onsets, frames, [*frames[1:], len(trajectory.head)], strict=True):
        if first < stop:
            part = slice(first, stop)
            segments.append(
                _Segment(onset, part, None if name is None else track.object_track(name).at(trajectory.times_s[part]))
            )
    return segments


def _too_close(trajectory: GazeTrajectory, track: TargetTrack) -> set[int]:
    """Indices of the model's saccades that start too shortly before a target."""
    onsets = np.array([each.onset_s for each in trajectory.saccades])
    spans = [np.searchsorted(onsets, [each.start_s - MIN_INTERVAL_S, each.start_s]) for each in track.targets]
    return {index for first, stop in spans for index in range(first, stop)}


def _saccade_end_s(trajectory: GazeTrajectory, time_s: float) -> float:
    """End of the saccade that is under way at a time; 0 if none is."""
    return max(
        (s.onset_s + s.duration_s for s in trajectory.saccades if s.onset_s < time_s < s.onset_s + s.duration_s),
        default=0.0,
    )


def _saccade_to(
    gaze: _Gaze,
    segment: _Segment,
    trajectory: GazeTrajectory,
    goal_rad: Float[ndarray, "N 2"],
    half_vergence_rad: Float[ndarray, "N 2"],
) -> None:
    """One saccade from the current gaze to a goal, which gaze then follows; vergence lags."""
    times = trajectory.times_s[segment.part]
    first = segment.part.start
    if first == 0:  # on target from the first frame
        gaze.cyclopean_rad[segment.part], gaze.half_vergence_rad[segment.part] = goal_rad, half_vergence_rad
        return
    start, apart = gaze.cyclopean_rad[first - 1], gaze.half_vergence_rad[first - 1] - half_vergence_rad[0]
    duration = float(saccades.duration_s(float(np.hypot(*(goal_rad[0] - start)))))
    landing = np.array([np.interp(segment.start_s + duration, times, axis) for axis in goal_rad.T])
    if np.hypot(*(landing - start)) < MIN_STEP_RAD:
        done = np.ones((len(times), 1))
    else:
        jump = main_sequence_saccade(segment.start_s, start, landing - start)
        done = saccades.completed_fraction((times - jump.onset_s) / jump.duration_s, jump.skew)[:, None]
        gaze.saccades.append(jump)
    gaze.cyclopean_rad[segment.part] = start + done * (goal_rad - start)
    gaze.half_vergence_rad[segment.part] = (
        half_vergence_rad + np.exp(-(times - segment.start_s) / TIME_CONSTANT_S)[:, None] * apart
    )


def _return_to_model(gaze: _Gaze, own: _Gaze, segment: _Segment, trajectory: GazeTrajectory) -> None:
    """One saccade to the model's gaze at landing; a saccade of the model during it is merged into it."""
    first, times = segment.part.start, trajectory.times_s[segment.part]
    step = own.cyclopean_rad[first] - gaze.cyclopean_rad[first - 1]
    lands_s = segment.start_s + float(saccades.duration_s(float(np.hypot(*step))))
    for each in own.saccades:
        if each.onset_s < lands_s + MIN_INTERVAL_S and lands_s < each.onset_s + each.duration_s:
            lands_s = each.onset_s + each.duration_s
    landed = min(int(np.ceil(lands_s * trajectory.fps)) - first, len(times) - 1)
    goal = own.cyclopean_rad[segment.part].copy()
    goal[:landed] = goal[landed]
    _saccade_to(gaze, segment, trajectory, goal, own.half_vergence_rad[segment.part])
    stop_s = segment.part.stop / trajectory.fps
    gaze.saccades += [each for each in own.saccades if lands_s <= each.onset_s < stop_s]


def _head_rotation_rad(trajectory: GazeTrajectory, segments: list[_Segment]) -> Float[ndarray, "T 2"]:
    """Rotation (yaw, pitch) of the head towards each target and back, to be added to the model's head motion."""
    pointing = rotation.direction_to_angles(rotation.rotvec_to_direction(trajectory.head))
    total = np.zeros((len(trajectory.head), 2))
    moves: list[HeadMovement] = []
    now = np.zeros(2)
    for segment in segments:
        level = target_head_contribution_rad(segment.targets, pointing[segment.part].mean(axis=0))
        step = level[0] - now
        if (size := float(np.hypot(*step))) > MIN_STEP_RAD:
            onset = segment.start_s + HEAD_LAG_S if segment.part.start else -1.0
            moves.append(HeadMovement(onset, float(eye_head.head_duration_s(size)), (step[0], step[1], 0.0)))
        followed = gaussian_filter1d(level - level[0], HEAD_PURSUIT_S * trajectory.fps, axis=0, mode="nearest")
        followed -= followed[0]
        total[segment.part] += followed
        total[segment.part.stop :] += followed[-1]
        now = level[0] + followed[-1]
    return np.asarray(total + eye_head.head_path(moves, trajectory.times_s)[:, :2])


def target_head_contribution_rad(
    targets: Float[ndarray, "N 4"] | None, pointing_rad: Float[ndarray, " 2"]
) -> Float[ndarray, "N 2"]:
    """Rotation (yaw, pitch) that a head that points somewhere adds for targets; 0 without them."""
    if targets is None:
        return np.zeros((1, 2))
    angles = rotation.direction_to_angles(targets[:, :3] / np.linalg.norm(targets[:, :3], axis=-1, keepdims=True))
    beside = angles - pointing_rad
    left = beside - eye_head.head_contribution(beside, HEAD_THRESHOLD_RAD, HEAD_GAIN)
    return np.asarray(beside - np.clip(left, *COMFORT_RANGE_RAD))
