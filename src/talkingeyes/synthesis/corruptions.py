"""What goes wrong between a face and its landmarks: hands and hair before it, dropped frames, coarse pictures.

Each is off at 0 (resolution and grid: at 1 and 0). What is covered or lost is NaN, as everywhere. Stretches come at
random moments, at a rate a minute, so longer clips have more of them; lengths are log-normal.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field, model_validator

from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES

# Where a hand or hair comes: the landmark that its middle lies on.
HAND = ("outline_chin", "upper_lip", "left_outline_jaw", "right_outline_jaw", "nose_tip", "left_eye_outer")
HAIR = ("left_outline_temple", "right_outline_temple", "left_brow_outer", "right_brow_outer")


class OcclusionSettings(Settings):
    """Hands and hair before the face: a disc, fixed to the face, that covers landmarks and pupils for a while."""

    rate_per_min: float = Field(ge=0, le=60)
    hand_probability: float = Field(ge=0, le=1)  # the others are hair
    median_s: float = Field(gt=0, le=60)  # median length
    log_std: float = Field(ge=0, le=2)  # of the logarithm of the length
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
    """Frames that a camera loses: shown as the frame before once more, or not at all."""

    dropped_fraction: float = Field(ge=0, lt=1)  # of the frames
    max_frames: int = Field(ge=1, le=100)  # a gap lasts 1 to so many
    repeat_probability: float = Field(ge=0, le=1)  # of the gaps repeat the frame before; the others are empty


def occlusion_mask(
    points: Float[ndarray, "T L 2"], pupils: Float[ndarray, "T 2 2"], fps: float, settings: OcclusionSettings,
    rng: np.random.Generator,
) -> Bool[ndarray, "T K"]:  # fmt: skip
    """Which landmarks, and after them which pupils, something is before at each frame."""
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
    """For each frame the frame that is shown in its place: itself, one before it, or -1 where there is none."""
    source = np.arange(frames)
    per_frame = settings.dropped_fraction / ((1.0 + settings.max_frames) / 2.0)
    for start in np.flatnonzero(rng.random(frames) < per_frame):
        stop = start + int(rng.integers(1, settings.max_frames + 1))
        source[start:stop] = source[start - 1] if start and rng.random() < settings.repeat_probability else -1
    return source


def quantise(points_px: Float[ndarray, "*N 2"], quantisation_px: float) -> Float[ndarray, "*N 2"]:
    """Coordinates rounded to steps of `quantisation_px`; 0 leaves them."""
    return np.asarray(np.round(points_px / quantisation_px) * quantisation_px) if quantisation_px else points_px
