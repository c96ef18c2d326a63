"""Noise of landmark and pupil detectors in pixels.

Pupil error is slow, not white. It consists of a bias per clip, partly shared by the eyes, a first-order autoregressive
part, a small white part, and a gain below 1 (the lids hide the iris). It grows as the head turns away. There are rare
bursts, and no detection while the lids hide the pupil. Landmark noise has the same parts but is smaller, and has
neither gain nor bursts. A low image resolution increases all of these and makes coordinates coarser. Occlusions and
lost frames are in `corruptions`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field, model_validator
from scipy.signal import lfilter

from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.synthesis.corruptions import FrameDropSettings, OcclusionSettings

CORRELATION_STEP_S = 0.04
YAW_SCALE_RAD = np.radians(30.0)
PUPIL_ERRORS, LANDMARK_ERRORS = ("bias", "ar", "white_min", "white_max"), ("bias", "ar", "white")


class PupilNoiseSettings(Settings):
    """Noise of the pupil detector in pixels at the scale of the crop; standard deviations unless stated otherwise."""

    bias_px: float = Field(ge=0, le=20)  # per clip, eye and axis
    bias_correlation: float = Field(ge=0, le=1)  # between the eyes
    ar_px: float = Field(ge=0, le=20)  # the autoregressive part
    ar_correlation: float = Field(ge=0, lt=1)  # over 40 ms
    white_min_px: float = Field(ge=0, le=20)  # the white part, sampled per clip from this range
    white_max_px: float = Field(ge=0, le=20)
    gain_x_min: float = Field(gt=0, le=2)  # motion of the detected pupil relative to the true one, sampled per eye
    gain_x_max: float = Field(gt=0, le=2)
    gain_y_min: float = Field(gt=0, le=2)
    gain_y_max: float = Field(gt=0, le=2)
    yaw_growth: float = Field(ge=0, le=10)  # growth of the noise with a head rotation of 30 degrees
    burst_share: float = Field(ge=0, le=1)  # fraction of frames in a burst
    burst_max_frames: int = Field(gt=0, le=100)  # a burst lasts 1 to this many frames
    burst_min_px: float = Field(ge=0, le=100)
    burst_max_px: float = Field(ge=0, le=100)
    min_aperture: float = Field(ge=0, le=1)  # aperture (1 open) below which the pupil is hidden

    @model_validator(mode="after")
    def _ordered(self) -> PupilNoiseSettings:
        for name in ("white_{}_px", "gain_x_{}", "gain_y_{}", "burst_{}_px"):
            least, most = getattr(self, name.format("min")), getattr(self, name.format("max"))
            if least > most:
                raise bounds_error(f"{name.format('max')} should be at least {name.format('min')} ({least})", most)
        return self


class LandmarkNoiseSettings(Settings):
    """Noise of the face landmarks in pixels at the scale of the crop; standard deviations."""

    bias_px: float = Field(ge=0, le=20)  # per clip, landmark and axis
    ar_px: float = Field(ge=0, le=20)  # the autoregressive part
    ar_correlation: float = Field(ge=0, lt=1)  # over 40 ms
    white_px: float = Field(ge=0, le=20)  # from frame to frame
    yaw_growth: float = Field(ge=0, le=10)  # growth of the noise with a head rotation of 30 degrees


class NoiseSettings(Settings):
    """Noise and corruptions of the simulated observations."""

    pupil: PupilNoiseSettings
    landmark: LandmarkNoiseSettings
    resolution: float = Field(gt=0, le=1)  # of the image, as a fraction of the crop's: noise grows as it falls
    quantisation_px: float = Field(ge=0, le=16)  # grid of the coordinates at full resolution; 0: none
    occlusion: OcclusionSettings
    frame_drops: FrameDropSettings

    @property
    def at_full_resolution(self) -> NoiseSettings:
        """Equivalent settings at full resolution: errors and grid are divided by the resolution."""
        larger = 1.0 / self.resolution
        pupil = {f"{name}_px": larger * getattr(self.pupil, f"{name}_px") for name in PUPIL_ERRORS}
        landmark = {f"{name}_px": larger * getattr(self.landmark, f"{name}_px") for name in LANDMARK_ERRORS}
        return self.model_copy(
            update={
                "pupil": self.pupil.model_copy(update=pupil),
                "landmark": self.landmark.model_copy(update=landmark),
                "quantisation_px": larger * self.quantisation_px,
                "resolution": 1.0,
            }
        )


def noisy_pupils(
    exact_px: Float[ndarray, "T 2 2"],
    ahead_px: Float[ndarray, "T 2 2"],
    head_yaw_rad: Float[ndarray, " T"],
    aperture: Float[ndarray, "T 2"],
    fps: float,
    settings: PupilNoiseSettings,
    rng: np.random.Generator,
) -> Float[ndarray, "T 2 2"]:
    """Detected pupils of both eyes, NaN where hidden. `ahead_px`: their positions for gaze straight ahead."""
    frames = len(exact_px)
    shared, own = rng.standard_normal((1, 2)), rng.standard_normal((2, 2))
    bias = settings.bias_px * (
        np.sqrt(settings.bias_correlation) * shared + np.sqrt(1.0 - settings.bias_correlation) * own
    )
    slow = autoregressive((frames, 2, 2), settings.ar_px, settings.ar_correlation, fps, rng)
    white = rng.uniform(settings.white_min_px, settings.white_max_px) * rng.standard_normal((frames, 2, 2))
    gain = np.stack(
        [
            rng.uniform(settings.gain_x_min, settings.gain_x_max, 2),
            rng.uniform(settings.gain_y_min, settings.gain_y_max, 2),
        ],
        axis=-1,
    )
    seen = ahead_px + gain * (exact_px - ahead_px)
    seen += (bias + slow + white) * _yaw_factor(head_yaw_rad, settings.yaw_growth)
    seen += outlier_bursts(frames, settings, rng)
    hidden: Bool[ndarray, "T 2"] = aperture < settings.min_aperture
    seen[hidden] = np.nan
    return np.asarray(seen)


def noisy_landmarks(
    exact_px: Float[ndarray, "T L 2"],
    head_yaw_rad: Float[ndarray, " T"],
    fps: float,
    settings: LandmarkNoiseSettings,
    rng: np.random.Generator,
) -> Float[ndarray, "T L 2"]:
    """Detected landmarks."""
    bias = settings.bias_px * rng.standard_normal(exact_px.shape[1:])
    slow = autoregressive(exact_px.shape, settings.ar_px, settings.ar_correlation, fps, rng)
    white = settings.white_px * rng.standard_normal(exact_px.shape)
    return np.asarray(exact_px + (bias + slow + white) * _yaw_factor(head_yaw_rad, settings.yaw_growth))


def autoregressive(
    shape: tuple[int, ...], deviation_px: float, correlation: float, fps: float, rng: np.random.Generator
) -> Float[ndarray, "T ..."]:
    """First-order autoregressive noise, stationary from the first frame; `correlation` is that over 40 ms."""
    step = correlation ** (1.0 / (fps * CORRELATION_STEP_S))
    drive = rng.standard_normal(shape)
    drive[1:] *= np.sqrt(1.0 - step**2)
    return np.asarray(deviation_px * lfilter([1.0], [1.0, -step], drive, axis=0))


def outlier_bursts(frames: int, settings: PupilNoiseSettings, rng: np.random.Generator) -> Float[ndarray, "T 2 2"]:
    """Outliers of single eyes: a constant offset in a random direction for a few frames."""
    added = np.zeros((frames, 2, 2))
    per_frame = settings.burst_share / ((1.0 + settings.burst_max_frames) / 2.0)
    starts, eyes = np.nonzero(rng.random((frames, 2)) < per_frame)
    for start, eye in zip(starts, eyes, strict=True):
        size, angle = rng.uniform(settings.burst_min_px, settings.burst_max_px), rng.uniform(0.0, 2.0 * np.pi)
        length = rng.integers(1, settings.burst_max_frames + 1)
        added[start : start + length, eye] = size * np.array([np.cos(angle), np.sin(angle)])
    return added


def _yaw_factor(head_yaw_rad: Float[ndarray, " T"], growth: float) -> Float[ndarray, "T 1 1"]:
    return np.asarray(1.0 + growth * np.abs(head_yaw_rad) / YAW_SCALE_RAD)[:, None, None]
