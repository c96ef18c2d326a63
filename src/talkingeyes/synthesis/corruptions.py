"""Corruptions of landmarks: occlusion by hands and hair, dropped frames, coarse coordinates.

Each is disabled at 0. Occluded or lost values are NaN, as everywhere. Occlusions start at random times with a constant
rate per minute, so longer clips have more of them; their durations are log-normal.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field, model_validator

from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES

# Landmarks at which the centre of an occluding hand or hair lies.
HAND = ("outline_chin", "upper_lip", "left_outline_jaw", "right_outline_jaw", "nose_tip", "left_eye_outer")
HAIR = ("left_outline_temple", "right_outline_temple", "left_brow_outer", "right_brow_outer")


class OcclusionSettings(Settings):
    """Occlusion by hands and hair: a disc fixed to the face that hides landmarks and pupils for some time."""

    rate_per_min: float = Field(ge=0, le=60)
    hand_probability: float = Field(ge=0, le=1)  # the remaining occlusions are hair
    median_s: float = Field(gt=0, le=60)  # median duration
    log_std: float = Field(ge=0, le=2)  # standard deviation of the log duration
    radius_min_px: float = Field(gt=0, le=4096)
    radius_max_px: float = Field(gt=0, le=4096)

    @model_validator(mode="after")
    def _ordered(self) -> OcclusionSettings:
        if self.radius_min_px > self.radius_max_px:
            raise bounds_error(
                f"radius_max_px should be at least radius_min_px ({self.radius_min_px})", self.radius_max_px
            )
        return self


class FrameDropSettings(Settings):
    """Frames lost by the camera: the previous frame is repeated, or the frame is empty."""

    dropped_fraction: float = Field(ge=0, lt=1)  # of all frames
    max_frames: int = Field(ge=1, le=100)  # a gap lasts 1 to this many frames
    # of gaps in which the previous frame is repeated; the others are empty
    repeat_probability: float = Field(ge=0, le=1)


def occlusion_mask(
    points: Float[ndarray, "T L 2"], pupils: Float[ndarray, "T 2 2"], fps: float, settings: OcclusionSettings,
    rng: np.random.Generator,
) -> Bool[ndarray, "T K"]:  # fmt: skip
    """Whether each landmark, followed by each pupil, is occluded in each frame."""
    everything = np.concatenate([points, pupils], axis=1)
    hidden = np.zeros(everything.shape[:2], bool)
    for _ in range(rng.poisson(settings.rate_per_min * len(points) / fps / 60.0)):
        places = HAND if rng.random() < settings.hand_probability else HAIR
        middle = LANDMARK_NAMES.index(places[rng.integers(len(places))])
        offset_px = rng.normal(0.0, 0.3 * settings.radius_min_px, 2)
        radius_px = rng.uniform(settings.radius_min_px, settings.radius_max_px)
        length = round(fps * settings.median_s * np.exp(settings.log_std * rng.standard_normal())) or 1
        start = int(rng.integers(1 - length, len(points)))
        during = slice(max(start, 0), start + length)
        away = everything[during] - (points[during, middle] + offset_px)[:, None]
        hidden[during] |= np.linalg.norm(away, axis=-1) < radius_px
    return hidden


def source_frames(frames: int, settings: FrameDropSettings, rng: np.random.Generator) -> ndarray:
    """Index of the frame shown in place of each frame: itself, an earlier one, or -1 for an empty frame."""
    source = np.arange(frames)
    per_frame = settings.dropped_fraction / ((1.0 + settings.max_frames) / 2.0)
    for start in np.flatnonzero(rng.random(frames) < per_frame):
        stop = start + int(rng.integers(1, settings.max_frames + 1))
        source[start:stop] = source[start - 1] if start and rng.random() < settings.repeat_probability else -1
    return source


def quantise(points_px: Float[ndarray, "*N 2"], quantisation_px: float) -> Float[ndarray, "*N 2"]:
    """Round coordinates to multiples of `quantisation_px`; 0 leaves them unchanged."""
    return np.asarray(np.round(points_px / quantisation_px) * quantisation_px) if quantisation_px else points_px
