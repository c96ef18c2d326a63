"""Head and gaze in space at the model's frame rate, with the saccades: what the steps of an animation change.

Gaze is the sum of a smooth part (drift and vergence) and a staircase of saccades. Steps move fixations, never single
frames: a saccade whose amplitude changes gets the duration of the main sequence (`physiology/saccades.py`), so it is
natural at any frame rate. Angles are (yaw, pitch) in radians, times seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.animation.saccade_resampling import saccade_staircase
from talkingeyes.core import rotation
from talkingeyes.core.motion import HeadMovement, Saccade
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.frame_saccades import find_saccades

MIN_STEP_RAD = 1e-6


@dataclass(frozen=True)
class GazeTrajectory:
    """T frames: head rotation vectors, directions of both optical axes in space, and the saccades."""

    fps: float
    head: Float[ndarray, "T 3"]
    gaze_in_space_rad: Float[ndarray, "T 2 2"]
    saccades: tuple[Saccade, ...]

    @classmethod
    def from_frames(
        cls, fps: float, head: Float[ndarray, "T 3"], gaze_in_space_rad: Float[ndarray, "T 2 2"]
    ) -> GazeTrajectory:
        """The trajectory of these frames; saccades are detected in the mean of both eyes, which has no blinks."""
        found = find_saccades(gaze_in_space_rad.mean(axis=1), fps, split_turns=True)
        return cls(fps, head, gaze_in_space_rad, found)

    @property
    def times_s(self) -> Float[ndarray, " T"]:
        """Time of each frame."""
        return np.arange(len(self.head)) / self.fps

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.head) / self.fps

    @property
    def cyclopean_rad(self) -> Float[ndarray, "T 2"]:
        """Cyclopean gaze: the mean of the angles of both eyes."""
        return np.asarray(self.gaze_in_space_rad.mean(axis=1))

    @property
    def steps_rad(self) -> Float[ndarray, "N 2"]:
        """Displacement of each saccade."""
        return np.array([np.subtract(each.end_rad, each.start_rad) for each in self.saccades]).reshape(-1, 2)

    @property
    def drift_rad(self) -> Float[ndarray, "T 2 2"]:
        """Gaze without its saccades: drift and vergence."""
        return np.asarray(self.gaze_in_space_rad - saccade_staircase(self.saccades, self.times_s)[:, None])


@dataclass(frozen=True)
class Fixations:
    """The K fixations between K - 1 saccades: start, end and mean gaze."""

    start_s: Float[ndarray, " K"]
    end_s: Float[ndarray, " K"]
    location_rad: Float[ndarray, "K 2"]


def fixations(trajectory: GazeTrajectory, gaze_rad: Float[ndarray, "T 2"]) -> Fixations:
    """Fixations of a trajectory, with the mean of `gaze_rad` (in any frame of reference) in each."""
    ends = np.array([(each.onset_s, each.onset_s + each.duration_s) for each in trajectory.saccades]).reshape(-1, 2)
    start = np.concatenate([[0.0], ends[:, 1]])
    end = np.maximum(np.concatenate([ends[:, 0], [trajectory.seconds]]), start)
    last = len(trajectory.head) - 1
    first_frame = np.clip(np.ceil(start * trajectory.fps - 1e-9).astype(int), 0, last)
    stop_frame = np.maximum(
        np.clip(np.floor(end * trajectory.fps + 1e-9).astype(int) + 1, 0, last + 1), first_frame + 1
    )
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(gaze_rad, axis=0)])
    location = (summed[stop_frame] - summed[first_frame]) / (stop_frame - first_frame)[:, None]
    return Fixations(start, end, location)


def shift_fixations(trajectory: GazeTrajectory, offsets_rad: Float[ndarray, "K 2"]) -> GazeTrajectory:
    """Move each fixation by an offset; the saccades between take up the differences."""
    smooth = trajectory.drift_rad + offsets_rad[0]
    return replace_steps(trajectory, smooth, trajectory.steps_rad + np.diff(offsets_rad, axis=0))


def remove_saccades(trajectory: GazeTrajectory, indices: Iterable[int]) -> GazeTrajectory:
    """Remove saccades: gaze stays at the earlier fixation, and the next saccade makes up for it."""
    steps = trajectory.steps_rad
    offsets = np.zeros((len(steps) + 1, 2))
    for index in sorted(indices):
        offsets[index + 1] = offsets[index] - steps[index]
    return shift_fixations(trajectory, offsets)


def replace_steps(
    trajectory: GazeTrajectory, drift_rad: Float[ndarray, "T 2 2"], steps_rad: Float[ndarray, "N 2"]
) -> GazeTrajectory:
    """Rebuild the trajectory from a smooth part and new steps at the saccades' onsets; zero steps are dropped."""
    onset_s = np.array([each.onset_s for each in trajectory.saccades])
    drift = drift_rad.mean(axis=1)
    start = np.stack([np.interp(onset_s, trajectory.times_s, axis) for axis in drift.T], axis=-1)
    start = start + np.cumsum(steps_rad, axis=0) - steps_rad
    new_saccades = tuple(
        main_sequence_saccade(float(onset), location, step)
        for onset, location, step in zip(onset_s, start, steps_rad, strict=True)
        if np.hypot(*step) > MIN_STEP_RAD
    )
    space = drift_rad + saccade_staircase(new_saccades, trajectory.times_s)[:, None]
    return replace(trajectory, gaze_in_space_rad=space, saccades=new_saccades)


def main_sequence_saccade(onset_s: float, start_rad: Float[ndarray, " 2"], step_rad: Float[ndarray, " 2"]) -> Saccade:
    """A saccade with duration and skew of the main sequence, without jitter."""
    size = float(np.hypot(*step_rad))
    (yaw, pitch), (to_yaw, to_pitch) = start_rad.tolist(), (start_rad + step_rad).tolist()
    duration, skew = float(saccades.duration_s(size)), float(saccades.skew(size))
    return Saccade(onset_s, duration, (yaw, pitch), (to_yaw, to_pitch), skew)


def split_fixations(trajectory: GazeTrajectory, onsets_s: Sequence[float]) -> GazeTrajectory:
    """Insert zero steps at further times, so that the fixations after them can be moved."""
    new = [main_sequence_saccade(onset, np.zeros(2), np.zeros(2)) for onset in onsets_s]
    return replace(trajectory, saccades=tuple(sorted([*trajectory.saccades, *new], key=lambda each: each.onset_s)))


def scale_gaze(
    trajectory: GazeTrajectory,
    centre_rad: Float[ndarray, " 2"],
    gain: Float[ndarray, " 2"],
    new_centre_rad: Float[ndarray, " 2"],
) -> GazeTrajectory:
    """Scale gaze about a centre by a gain for yaw and pitch, and move the centre; vergence stays."""
    smooth = trajectory.drift_rad
    drift = smooth.mean(axis=1)
    moved = new_centre_rad + gain * (drift - centre_rad)
    return replace_steps(trajectory, smooth - drift[:, None] + moved[:, None], trajectory.steps_rad * gain)


def add_head_rotation(trajectory: GazeTrajectory, along_rad: Float[ndarray, "T 2"]) -> GazeTrajectory:
    """Add a rotation (yaw, pitch) to the head; gaze in space stays."""
    extra = np.stack([-along_rad[:, 1], along_rad[:, 0], np.zeros(len(along_rad))], axis=-1)
    return replace(trajectory, head=trajectory.head + extra)


def add_head_turns(
    trajectory: GazeTrajectory,
    onsets_s: Float[ndarray, " K"],
    eccentricity_rad: Float[ndarray, "K 2"],
    threshold_rad: float,
    gain: float,
) -> GazeTrajectory:
    """Add the head contribution to the eccentricity of gaze from each onset on (`physiology/eye_head.py`)."""
    levels = eye_head.head_contribution(eccentricity_rad, threshold_rad, gain)
    moves = []
    for onset, step in zip(onsets_s, np.diff(levels, axis=0, prepend=np.zeros((1, 2))), strict=True):
        if size := float(np.hypot(*step)):
            lag = eye_head.ONSET_LAG_S[0] if onset else -1.0
            moves.append(
                HeadMovement(float(onset) + lag, float(eye_head.head_duration_s(size)), (step[0], step[1], 0.0))
            )
    return add_head_rotation(trajectory, eye_head.head_path(moves, trajectory.times_s)[:, :2])


def hold_gaze(trajectory: GazeTrajectory, shut: Bool[ndarray, " T"]) -> GazeTrajectory:
    """Hold gaze in space while the lids are shut, and detect the saccades again."""
    held = hold_frames(trajectory.gaze_in_space_rad, shut)
    return GazeTrajectory.from_frames(trajectory.fps, trajectory.head, held)


def hold_frames(
    frames: Float[ndarray, "T 2 2"], held: Bool[ndarray, " T"], previous: Float[ndarray, "2 2"] | None = None
) -> Float[ndarray, "T 2 2"]:
    """Repeat the last frame before each run of held frames; `previous` is the frame before the first, in a stream."""
    padded = np.concatenate([frames[:1] if previous is None else previous[None], frames])
    source = np.maximum.accumulate(np.where(held, 0, np.arange(1, len(frames) + 1)))
    return np.asarray(padded[source])


def clamp_changed_gaze(trajectory: GazeTrajectory, generated: GazeTrajectory) -> GazeTrajectory:
    """Clamp gaze to the oculomotor range in the frames in which it differs from the generated trajectory."""
    moved = np.abs(trajectory.gaze_in_space_rad - generated.gaze_in_space_rad).max(axis=(1, 2)) + np.abs(
        trajectory.head - generated.head
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
