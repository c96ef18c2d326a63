"""Accuracy of fitted pupils (Table VIII): distance to the true pupils, pupil speed, saccade peak ratio.

Pupil speed is relative to the projected centre of its eye, in pixels per second, under one head pose for all methods,
in frames without blinks. The saccade peak ratio compares the peak speed of a method with that of the ground truth. Both
are sampled at the frame rate, over all runs of frames in which the true gaze in space moves at 25 degrees per second or
more. Functions return sums instead of means, so that clips can be pooled.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_in_space
from talkingeyes.fitting.gaps import runs
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, head_to_scene, pupil_centres

SACCADE_RAD_S = np.radians(25.0)


@dataclass(frozen=True)
class ErrorSums:
    """Sums over frames and eyes (distances and speeds) and over saccades and eyes (peaks), each with its count."""

    truth_distance_px: float = 0.0
    truth_distances: int = 0
    input_distance_px: float = 0.0
    input_distances: int = 0
    speed_px_s: float = 0.0
    speeds: int = 0
    peak_px_s: float = 0.0
    peaks: int = 0

    def __add__(self, other: ErrorSums) -> ErrorSums:
        return ErrorSums(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(ErrorSums)))


def pool_errors(tallies: Iterable[ErrorSums]) -> ErrorSums:
    """Add up the sums of clips."""
    return sum(tallies, ErrorSums())


@dataclass(frozen=True)
class FitReference:
    """Common conditions of the compared methods: observed pupils, camera, counted frames, head pose, truth if known."""

    pupils: Float[ndarray, "T 2 2"]
    camera: Camera
    frame_mask: Bool[ndarray, " T"]
    pose: Motion
    truth: Motion | None

    def error_sums(self, motion: Motion) -> ErrorSums:
        """Error sums of one method: distances under its own head pose, speeds under the common one."""
        placed = _pixels(motion, pupil_centres(motion.gaze), self.camera)
        noisy = np.linalg.norm(placed - self.pupils, axis=-1)[self.frame_mask]
        noisy = noisy[np.isfinite(noisy)]
        speed = self._speeds(motion)
        moving = self.frame_mask[1:] & self.frame_mask[:-1]
        error_sums = ErrorSums(
            input_distance_px=float(noisy.sum()),
            input_distances=noisy.size,
            speed_px_s=float(speed[moving].sum()),
            speeds=speed[moving].size,
        )
        return error_sums if self.truth is None else error_sums + self._against_truth(self.truth, placed, speed)

    def _against_truth(self, truth: Motion, placed: Float[ndarray, "T 2 2"], speed: Float[ndarray, "S 2"]) -> ErrorSums:
        exact = _pixels(truth, pupil_centres(truth.gaze), self.camera)
        distance = np.linalg.norm(placed - exact, axis=-1)[self.frame_mask]
        peaks = [speed[start:stop].max(axis=0) for start, stop in self._saccades(truth)]
        return ErrorSums(
            truth_distance_px=float(distance.sum()),
            truth_distances=distance.size,
            peak_px_s=float(np.sum(peaks)),
            peaks=2 * len(peaks),
        )

    def _speeds(self, motion: Motion) -> Float[ndarray, "S 2"]:
        """Speed of each pupil relative to the centre of its eye under the common pose, pixels per second."""
        centres = np.broadcast_to(EYE_CENTRES, (len(motion), 2, 3))
        relative = _pixels(self.pose, pupil_centres(motion.gaze), self.camera) - _pixels(
            self.pose, centres, self.camera
        )
        return np.asarray(np.linalg.norm(np.diff(relative, axis=0), axis=-1) * motion.fps)

    def _saccades(self, truth: Motion) -> list[tuple[int, int]]:
        """Runs of frame steps inside true saccades, without runs that touch an excluded frame."""
        version = gaze_in_space(truth.head, truth.gaze).mean(axis=1)
        fast = np.linalg.norm(np.diff(version, axis=0), axis=-1) * truth.fps >= SACCADE_RAD_S
        moving = self.frame_mask[1:] & self.frame_mask[:-1]
        return [(start, stop) for start, stop in runs(fast) if moving[start:stop].all()]


def _pixels(motion: Motion, points: Float[ndarray, "T K 3"], camera: Camera) -> Float[ndarray, "T K 2"]:
    return camera.project(head_to_scene(points, motion.head, motion.translation))
