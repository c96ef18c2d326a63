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

from talkingeyes.animation.saccade_resampling import saccade_staircase
from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMovement, Saccade
from talkingeyes.physiology import eye_head, saccades

MIN_STEP_RAD = 1e-6


@dataclass(frozen=True)
class GazeTrajectory:
    """T frames at the model's rate: the head, where each eye's optical axis points in space, and the saccades."""

    fps: float
    head: Float[ndarray, "T 3"]
    gaze_in_space_rad: Float[ndarray, "T 2 2"]
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
    def cyclopean_rad(self) -> Float[ndarray, "T 2"]:
        """Where both eyes look together, as the saccades have it: the mean of their angles."""
        return np.asarray(self.gaze_in_space_rad.mean(axis=1))

    @property
    def steps_rad(self) -> Float[ndarray, "N 2"]:
        """How far each saccade goes."""
        return np.array([np.subtract(each.end_rad, each.start_rad) for each in self.saccades]).reshape(-1, 2)

    @property
    def drift_rad(self) -> Float[ndarray, "T 2 2"]:
        """Gaze without its saccades: drift, and what the eyes differ by."""
        return np.asarray(self.gaze_in_space_rad - saccade_staircase(self.saccades, self.times_s)[:, None])


@dataclass(frozen=True)
class Fixations:
    """The stretches between K - 1 saccades: when, and where gaze is on average."""

    start_s: Float[ndarray, " K"]
    end_s: Float[ndarray, " K"]
    location_rad: Float[ndarray, "K 2"]


def fixations(trajectory: GazeTrajectory, gaze_rad: Float[ndarray, "T 2"]) -> Fixations:
    """Where `gaze_rad` (as seen from anywhere, such as from the listener) is in each fixation of a course."""
    ends = np.array([(each.onset_s, each.onset_s + each.duration_s) for each in trajectory.saccades]).reshape(-1, 2)
    start = np.concatenate([[0.0], ends[:, 1]])
    end = np.maximum(np.concatenate([ends[:, 0], [trajectory.seconds]]), start)
    last = len(trajectory.head) - 1
    first_frame = np.clip(np.ceil(start * trajectory.fps - 1e-9).astype(int), 0, last)
    stop_frame = np.maximum(
        np.clip(np.floor(end * trajectory.fps + 1e-9).astype(int) + 1, 0, last + 1), first_frame + 1
    )
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(gaze_rad, axis=0)])
    place = (summed[stop_frame] - summed[first_frame]) / (stop_frame - first_frame)[:, None]
    return Fixations(start, end, place)


def shift_fixations(trajectory: GazeTrajectory, offsets_rad: Float[ndarray, "K 2"]) -> GazeTrajectory:
    """The course with each fixation moved by an offset; the saccades between take what their offsets differ by."""
    smooth = trajectory.drift_rad + offsets_rad[0]
    return replace_steps(trajectory, smooth, trajectory.steps_rad + np.diff(offsets_rad, axis=0))


def remove_saccades(trajectory: GazeTrajectory, indices: Iterable[int]) -> GazeTrajectory:
    """The course without some of its saccades: gaze stays where it was, and the next saccade takes their steps too."""
    steps = trajectory.steps_rad
    offsets = np.zeros((len(steps) + 1, 2))
    for index in sorted(indices):
        offsets[index + 1] = offsets[index] - steps[index]
    return shift_fixations(trajectory, offsets)


def replace_steps(
    trajectory: GazeTrajectory, drift_rad: Float[ndarray, "T 2 2"], steps_rad: Float[ndarray, "N 2"]
) -> GazeTrajectory:
    """A course of this smooth part and steps at the saccades' onsets; a step of nothing is no saccade any more."""
    onset_s = np.array([each.onset_s for each in trajectory.saccades])
    drift = drift_rad.mean(axis=1)
    start = np.stack([np.interp(onset_s, trajectory.times_s, axis) for axis in drift.T], axis=-1)
    start = start + np.cumsum(steps_rad, axis=0) - steps_rad
    jumps = tuple(
        main_sequence_saccade(float(onset), place, step)
        for onset, place, step in zip(onset_s, start, steps_rad, strict=True)
        if np.hypot(*step) > MIN_STEP_RAD
    )
    space = drift_rad + saccade_staircase(jumps, trajectory.times_s)[:, None]
    return replace(trajectory, gaze_in_space_rad=space, saccades=jumps)


def main_sequence_saccade(onset_s: float, start_rad: Float[ndarray, " 2"], step_rad: Float[ndarray, " 2"]) -> Saccade:
    """A saccade of the main sequence, without jitter."""
    size = float(np.hypot(*step_rad))
    (yaw, pitch), (to_yaw, to_pitch) = start_rad.tolist(), (start_rad + step_rad).tolist()
    duration, skew = float(saccades.duration_s(size)), float(saccades.skew(size))
    return Saccade(onset_s, duration, (yaw, pitch), (to_yaw, to_pitch), skew)


def split_fixations(trajectory: GazeTrajectory, onsets_s: Sequence[float]) -> GazeTrajectory:
    """The course with steps of nothing at further times, so that what follows them can be aimed elsewhere."""
    new = [main_sequence_saccade(onset, np.zeros(2), np.zeros(2)) for onset in onsets_s]
    return replace(trajectory, saccades=tuple(sorted([*trajectory.saccades, *new], key=lambda each: each.onset_s)))


def scale_gaze(
    trajectory: GazeTrajectory,
    centre_rad: Float[ndarray, " 2"],
    gain: Float[ndarray, " 2"],
    new_centre_rad: Float[ndarray, " 2"],
) -> GazeTrajectory:
    """Gaze as far from a new centre as it was from the old one, times a gain for yaw and pitch; vergence stays."""
    smooth = trajectory.drift_rad
    drift = smooth.mean(axis=1)
    moved = new_centre_rad + gain * (drift - centre_rad)
    return replace_steps(trajectory, smooth - drift[:, None] + moved[:, None], trajectory.steps_rad * gain)


def add_head_rotation(trajectory: GazeTrajectory, along_rad: Float[ndarray, "T 2"]) -> GazeTrajectory:
    """The head turned further by (yaw, pitch); gaze in space stays."""
    extra = np.stack([-along_rad[:, 1], along_rad[:, 0], np.zeros(len(along_rad))], axis=-1)
    return replace(trajectory, head=trajectory.head + extra)


def add_head_turns(
    trajectory: GazeTrajectory,
    onsets_s: Float[ndarray, " K"],
    eccentricity_rad: Float[ndarray, "K 2"],
    threshold_rad: float,
    gain: float,
) -> GazeTrajectory:
    """The head turned further by its part in where gaze is from each onset on (physiology.eye_head)."""
    levels = eye_head.head_contribution(eccentricity_rad, threshold_rad, gain)
    moves = []
    for onset, step in zip(onsets_s, np.diff(levels, axis=0, prepend=np.zeros((1, 2))), strict=True):
        if size := float(np.hypot(*step)):
            lag = eye_head.ONSET_LAG_S[0] if onset else -1.0
            moves.append(
                HeadMovement(float(onset) + lag, float(eye_head.head_duration_s(size)), (step[0], step[1], 0.0))
            )
    return add_head_rotation(trajectory, eye_head.head_path(moves, trajectory.times_s)[:, :2])


def clamp_gaze(trajectory: GazeTrajectory, own: GazeTrajectory) -> GazeTrajectory:
    """Gaze no further from the head than eyes turn, where it is not the model's own."""
    moved = np.abs(trajectory.gaze_in_space_rad - own.gaze_in_space_rad).max(axis=(1, 2)) + np.abs(
        trajectory.head - own.head
    ).max(axis=1)
    changed = np.flatnonzero(moved > MIN_STEP_RAD)
    head = trajectory.head[changed]
    angles = rotation.gaze_to_angles(rotation.eye_in_head(head, trajectory.gaze_in_space_rad[changed]))
    within = eye_head.clamp_angles(angles)
    beyond = (within != angles).any(axis=(-2, -1))
    eyes = rotation.angles_to_gaze(within[beyond])
    space = trajectory.gaze_in_space_rad.copy()
    space[changed[beyond]] = rotation.gaze_in_space(head[beyond], eyes)
    return replace(trajectory, gaze_in_space_rad=space)
