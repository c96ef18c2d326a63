"""Head poses as six numbers, as in "3D Talking Face with Personalized Pose Dynamics" (Zhang et al., section 3).

A pose is (pitch, yaw, roll, x, y, z): intrinsic Euler angles in radians (pitch positive up) and metres. Poses are
fitted motion, resampled to the paper's 30 fps, Gaussian-filtered (eq. 1), and centred per set of clips. A set is the
clips of one camera; here that is one clip, because every clip has its own camera and distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from scipy.spatial.transform import Rotation

from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.fitted_clips import FittedClips, motion_path, require_clips
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path


class PoseSettings(Settings):
    """How poses are computed from motions."""

    # Frames per second of poses (the paper: 30).
    fps: Annotated[float, Field(gt=0, le=240)]
    # Standard deviation (delta) of the Gaussian of eq. 1 and its radius (m), in frames; standard deviation 0: no
    # filter.
    filter_sigma_frames: Annotated[float, Field(ge=0)]
    filter_radius_frames: Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class PoseRecording:
    """One clip at the frame rate of poses: speech embedding, centred poses, and their original mean."""

    clip: Clip
    speech: Float[ndarray, "T C"]
    pose: Float[ndarray, "T 6"]
    centre: Float[ndarray, " 6"]

    def __len__(self) -> int:
        return len(self.pose)


def to_poses(head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"]) -> Float[ndarray, "T 6"]:
    """Six numbers per frame from rotation vectors and translations in metres."""
    yaw, down, roll = Rotation.from_rotvec(head).as_euler("YXZ").T
    return np.concatenate([np.stack([-down, yaw, roll], axis=1), translation], axis=1)


def head_rotations(pose: Float[ndarray, "*N 6"]) -> Float[ndarray, "*N 3"]:
    """Rotation vectors of poses; with the last three numbers, the inverse of `to_poses`."""
    pitch, yaw, roll = (pose[..., index].ravel() for index in range(3))
    turned = Rotation.from_euler("YXZ", np.stack([yaw, -pitch, roll], axis=1))
    return np.asarray(turned.as_rotvec().reshape(*pose.shape[:-1], 3))


def resample_cubic(rows: Float[ndarray, "T C"], fps: float, new_fps: float) -> Float[ndarray, "U C"]:
    """Resample rows to another frame rate by a cubic spline; the first row stays in place."""
    if fps == new_fps:
        return rows
    from scipy.interpolate import CubicSpline

    times_s, new_s = _times(len(rows), fps, new_fps)
    if len(rows) < 4:
        return resample_linear(rows, fps, new_fps)
    return np.asarray(CubicSpline(times_s, rows)(new_s))


def resample_linear(rows: Float[ndarray, "T C"], fps: float, new_fps: float) -> Float[ndarray, "U C"]:
    """Resample rows linearly to another frame rate: for features, which a spline could move out of range."""
    if fps == new_fps or not len(rows):
        return rows
    place = (_times(len(rows), fps, new_fps)[1] * fps).clip(0, len(rows) - 1)
    left = place.astype(int)
    share = (place - left)[:, None].astype(rows.dtype)
    return np.asarray(rows[left] * (1 - share) + rows[np.minimum(left + 1, len(rows) - 1)] * share)


def _times(count: int, fps: float, new_fps: float) -> tuple[ndarray, ndarray]:
    """Times of the old and of the new frames; no new frame lies beyond the last old one."""
    return np.arange(count) / fps, np.arange(int((count - 1) * new_fps / fps + 1e-9) + 1) / new_fps


def gaussian_smooth(pose: Float[ndarray, "T N"], width_frames: float, reach: int) -> Float[ndarray, "T N"]:
    """Eq. 1 with weights that sum to 1, also at the ends of a clip."""
    if width_frames == 0:
        return pose
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / width_frames) ** 2)
    known = np.convolve(np.ones(len(pose)), weights, mode="full")[reach : reach + len(pose)]
    columns = [np.convolve(column, weights, mode="full")[reach : reach + len(pose)] for column in pose.T]
    return np.asarray(np.stack(columns, axis=1) / known[:, None])


class PoseRecordings(FittedClips[PoseRecording]):
    """Head poses of fitted clips; 128 are cached."""

    def __init__(self, clips: Sequence[Clip], fit: Path, embed: Path, settings: PoseSettings) -> None:
        super().__init__(clips, fit, lru_cache(maxsize=128)(lambda clip: read_poses(fit, embed, clip, settings)))


def read_poses(fit: Path, embed: Path, clip: Clip, settings: PoseSettings) -> PoseRecording:
    """A fitted clip and its sound at the frame rate of poses."""
    motion = Motion.load(motion_path(fit, clip))
    raw = resample_cubic(to_poses(motion.head, motion.translation), motion.fps, settings.fps)
    pose = gaussian_smooth(raw, settings.filter_sigma_frames, settings.filter_radius_frames)
    embedding = np.load(shard_path(embed / "speech", clip.sound, ".npy"))
    speech = resample_linear(embedding, motion.fps, settings.fps)
    frames = min(len(pose), len(speech))
    centre = pose[:frames].mean(0)
    centred = (pose[:frames] - centre).astype(np.float32)
    return PoseRecording(clip, speech[:frames].astype(np.float32), centred, centre.astype(np.float32))


def pose_recordings(
    corpus: Corpus, fit: Path, embed: Path, settings: PoseSettings, *splits: str, take: int | None = None
) -> PoseRecordings:
    """The fitted clips of the given splits. Raises InputError if there is none."""
    return require_clips(PoseRecordings(corpus.select(*splits, take=take), fit, embed, settings), corpus, splits)
