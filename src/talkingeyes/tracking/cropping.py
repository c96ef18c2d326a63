"""Converts a shot to an observation: resampled by time stamps, in pixels of a standard crop around the face.

The crop is fixed within a shot and as large as that of synthetic data, so that quantities in pixels (the tolerances of
`fit`, Table VIII) have the same meaning for films of 224 and of 2160 lines. The lens of a video is unknown: the camera
is assumed to look at the centre of the crop from `distance_m`. The size of the face comes from the rigid landmarks
under scaled orthography, which head rotation does not shrink. `fit` estimates the identity of the face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import EYE_CENTRES, RIGID_LANDMARKS, rest_landmarks
from talkingeyes.head.observation import Observation
from talkingeyes.tracking.shots import Shot
from talkingeyes.tracking.visibility import EyeVisibilitySettings, eye_openness, self_occluded

Positive = Annotated[float, Field(gt=0)]


class CropSettings(Settings):
    """Size, scale and camera distance of the crop; no interpolation between frames further apart than `max_gap_s`."""

    size_px: Annotated[int, Field(ge=32, le=4096)]
    scale_px_per_mm: Annotated[float, Field(gt=0, le=100)]
    distance_m: Annotated[float, Field(ge=0.3, le=10)]
    max_gap_s: Positive


@dataclass(frozen=True)
class Crop:
    """Pixels of the crop are (pixels of the video - corner) * zoom."""

    x: float
    y: float
    zoom: float

    def to_crop(self, points: Float[ndarray, "*N 2"]) -> Float[ndarray, "*N 2"]:
        """Convert pixels of the video to pixels of the crop."""
        return np.asarray((points - (self.x, self.y)) * self.zoom)


@dataclass(frozen=True)
class CroppedShot:
    """Observation of a shot, and its crop."""

    observation: Observation
    crop: Crop


def frame_count(shot: Shot, fps: float) -> int:
    """Number of frames at `fps` that start within the shot."""
    return int((shot.stop_s - shot.start_s) * fps + 1e-6) + 1


def crop_shot(shot: Shot, fps: float, settings: CropSettings, eyes: EyeVisibilitySettings) -> CroppedShot:
    """Landmarks and pupils at the times start + t / fps; pupils are NaN if the eye is hidden."""
    seen = [tracked for tracked in shot.tracked_frames if tracked.face is not None]
    times_s = np.array([tracked.time_s for tracked in seen])
    points = np.array(
        [np.concatenate([tracked.face.landmarks, tracked.face.pupils]) for tracked in seen if tracked.face]
    )
    crop = face_crop(points[:, :-2], settings)
    target_times_s = shot.start_s + np.arange(frame_count(shot, fps)) / fps
    resampled = resample_at(crop.to_crop(points), times_s, target_times_s, settings.max_gap_s)
    landmarks, pupils = resampled[:, :-2], resampled[:, -2:]
    opening = eye_openness(landmarks, eyes.open_percentile)
    hidden = ~(opening >= eyes.min_aperture) | self_occluded(landmarks, eyes)
    confidence = np.clip(np.nan_to_num(opening.min(axis=1)) / max(eyes.min_aperture, 1e-9), 0.0, 1.0)
    pupils = np.where(hidden[..., None], np.nan, pupils)
    return CroppedShot(Observation(fps, landmarks, pupils, confidence, crop_camera(settings)), crop)


def resample_at(
    points: Float[ndarray, "F L 2"],
    times_s: Float[ndarray, " F"],
    target_times_s: Float[ndarray, " T"],
    max_gap_s: float,
) -> Float[ndarray, "T L 2"]:
    """Interpolate linearly between frames; NaN if they are further apart than `max_gap_s`."""
    after = np.clip(np.searchsorted(times_s, target_times_s), 1, max(len(times_s) - 1, 1))
    if len(times_s) == 1:
        return np.repeat(points, len(target_times_s), axis=0)
    before = after - 1
    gap_s = times_s[after] - times_s[before]
    share = np.clip((target_times_s - times_s[before]) / gap_s, 0.0, 1.0)[:, None, None]
    between = points[before] * (1 - share) + points[after] * share
    exact = (share == 0) | (share == 1)
    return np.where((gap_s[:, None, None] <= max_gap_s + 1e-6) | exact, between, np.nan)


def face_crop(landmarks: Float[ndarray, "F L 2"], settings: CropSettings) -> Crop:
    """The crop centred on the face (the median of its boxes), at the standard scale."""
    zoom = settings.scale_px_per_mm / float(np.median(pixels_per_mm(landmarks)))
    boxes = (landmarks.min(axis=1) + landmarks.max(axis=1)) / 2
    corner = np.median(boxes, axis=0) - settings.size_px / 2 / zoom
    return Crop(float(corner[0]), float(corner[1]), zoom)


def pixels_per_mm(landmarks: Float[ndarray, "F L 2"]) -> Float[ndarray, " F"]:
    """Pixels per millimetre of each frame: scaled orthography of the rigid landmarks, for any head rotation."""
    rest = rest_landmarks()[RIGID_LANDMARKS] * 1000.0
    rest = rest - rest.mean(axis=0)
    seen = landmarks[:, RIGID_LANDMARKS] - landmarks[:, RIGID_LANDMARKS].mean(axis=1, keepdims=True)
    affine = np.einsum("kr,frc->fkc", np.linalg.pinv(rest), seen)
    return np.asarray(np.linalg.svd(affine, compute_uv=False).mean(axis=1))


def crop_camera(settings: CropSettings) -> Camera:
    """The assumed camera of a crop."""
    half = settings.size_px / 2.0
    focal_px = 1000.0 * settings.scale_px_per_mm * (settings.distance_m - float(EYE_CENTRES[0, 2]))
    return Camera(focal_px, (half, half), settings.distance_m, settings.size_px, settings.size_px)
