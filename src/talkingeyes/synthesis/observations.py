"""Simulated camera observations of a take: landmarks and pupil centres in pixels, with detector noise.

The scale is that of a 224 x 224 face crop (1.154 pixels per millimetre at the eyes) at any camera distance; the
distance affects only perspective. Landmarks are those of the speaker's head (weights of the identity shapes of the open
head), with expression. The noiseless pupil is a function of Motion and camera (`exact_pupils_px`), so it is not stored.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field, model_validator

from talkingeyes.core.motion import Motion
from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.head import landmarks as face
from talkingeyes.head.camera import Camera
from talkingeyes.head.observation import Observation
from talkingeyes.synthesis.corruptions import occlusion_mask, quantise, source_frames
from talkingeyes.synthesis.detector_noise import NoiseSettings, noisy_landmarks, noisy_pupils

IDENTITY_LIMIT = 2.0  # standard deviations; faces beyond are not plausible


class CameraSettings(Settings):
    """The camera in front of the speakers, and the variation of their heads."""

    size_px: int = Field(ge=32, le=4096)  # width and height of the image
    scale_px_per_mm: float = Field(gt=0, le=100)  # at the distance of the eyes
    distance_min_m: float = Field(ge=0.3, le=10)  # from the head's joint, sampled per clip
    distance_max_m: float = Field(ge=0.3, le=10)
    identity_std: float = Field(ge=0, le=0.5)  # standard deviation over speakers of the weights of identity shapes

    @model_validator(mode="after")
    def _ordered(self) -> CameraSettings:
        if self.distance_min_m > self.distance_max_m:
            raise bounds_error(
                f"distance_max_m should be at least distance_min_m ({self.distance_min_m})", self.distance_max_m
            )
        return self


def make_camera(settings: CameraSettings, rng: np.random.Generator) -> Camera:
    """Sample a pinhole camera within the distance range, with the neutral face at the image centre."""
    distance_m = float(rng.uniform(settings.distance_min_m, settings.distance_max_m))
    depth_m = distance_m - float(face.EYE_CENTRES[0, 2])
    focal_px = 1000.0 * settings.scale_px_per_mm * depth_m
    heights_m = face.rest_landmarks()[:, 1]
    middle_m = float(heights_m.min() + heights_m.max()) / 2.0
    half = settings.size_px / 2.0
    return Camera(
        focal_px=focal_px,
        centre_px=(half, half + focal_px * middle_m / depth_m),
        distance_m=distance_m,
        width=settings.size_px,
        height=settings.size_px,
    )


def identity_weights(identity: Sequence[float], settings: CameraSettings) -> tuple[float, ...]:
    """Weights of the head's identity shapes from standard normal numbers."""
    return tuple(float(settings.identity_std * np.clip(number, -IDENTITY_LIMIT, IDENTITY_LIMIT)) for number in identity)


def exact_pupils_px(motion: Motion, camera: Camera) -> Float[ndarray, "T 2 2"]:
    """True pupil positions in the image."""
    return camera.project(face.head_to_scene(face.pupil_centres(motion.gaze), motion.head, motion.translation))


def exact_landmarks_px(motion: Motion, camera: Camera, identity: Sequence[float] = ()) -> Float[ndarray, "T L 2"]:
    """True landmark positions in the image."""
    return camera.project(face.head_to_scene(face.motion_landmarks(motion, identity), motion.head, motion.translation))


def observe(
    motion: Motion,
    camera: Camera,
    settings: NoiseSettings,
    rng: np.random.Generator,
    identity: Sequence[float] = (),
) -> Observation:
    """Landmarks and pupils as detected; confidence decreases to 0 with the hidden part.

    `identity`: weights of the head's identity shapes, which the observation contains as from a face tracker.
    """
    settings = settings.at_full_resolution
    ahead = np.zeros_like(motion.gaze)
    ahead_px = camera.project(face.head_to_scene(face.pupil_centres(ahead), motion.head, motion.translation))
    aperture = 1.0 - motion.lid
    yaw = motion.head[:, 1]
    exact_px = exact_landmarks_px(motion, camera, identity)
    pupils_px = exact_pupils_px(motion, camera)
    landmarks = noisy_landmarks(exact_px, yaw, motion.fps, settings.landmark, rng)
    pupils = noisy_pupils(pupils_px, ahead_px, yaw, aperture, motion.fps, settings.pupil, rng)
    hidden = occlusion_mask(exact_px, pupils_px, motion.fps, settings.occlusion, rng)
    landmarks[hidden[:, :-2]] = np.nan
    pupils[hidden[:, -2:]] = np.nan
    openness = np.clip(aperture.min(axis=1) / max(settings.pupil.min_aperture, 1e-9), 0.0, 1.0)
    shown = source_frames(len(motion), settings.frame_drops, rng)
    lost = shown < 0
    return Observation(
        fps=motion.fps,
        landmarks=quantise(np.where(lost[:, None, None], np.nan, landmarks[shown]), settings.quantisation_px),
        pupils=quantise(np.where(lost[:, None, None], np.nan, pupils[shown]), settings.quantisation_px),
        confidence=np.where(lost, 0.0, (openness * (1.0 - hidden.mean(axis=1)))[shown]),
        camera=camera,
        identity=tuple(identity),
    )
