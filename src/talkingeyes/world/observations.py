"""What a camera sees of a take: landmarks and pupil centres in pixels, with the detectors' noise.

The scale is that of a 224 x 224 crop of a face (1.154 pixels a millimetre at the eyes, FACTS section 8). The
noiseless pupil is a function of Motion and camera alone (`exact_pupils_px`), so nothing more is stored.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.head import landmarks as face
from talkingeyes.head.camera import Camera
from talkingeyes.head.observation import Observation
from talkingeyes.motion import Motion
from talkingeyes.settings import Settings
from talkingeyes.world.noise import NoiseSettings, noisy_landmarks, noisy_pupils


class CameraSettings(Settings):
    """The camera in front of every speaker."""

    size_px: int = Field(ge=32, le=4096)  # width and height of the picture
    scale_px_per_mm: float = Field(gt=0, le=100)  # at the distance of the eyes
    distance_m: float = Field(ge=0.3, le=10)  # from the head's joint


def make_camera(settings: CameraSettings) -> Camera:
    """A pinhole camera with the neutral face in the middle of its picture."""
    depth_m = settings.distance_m - float(face.EYE_CENTRES[0, 2])
    focal_px = 1000.0 * settings.scale_px_per_mm * depth_m
    heights_m = face.rest_points()[:, 1]
    middle_m = float(heights_m.min() + heights_m.max()) / 2.0
    half = settings.size_px / 2.0
    return Camera(
        focal_px=focal_px,
        centre_px=(half, half + focal_px * middle_m / depth_m),
        distance_m=settings.distance_m,
        width=settings.size_px,
        height=settings.size_px,
    )


def exact_pupils_px(motion: Motion, camera: Camera) -> Float[ndarray, "T 2 2"]:
    """Where the pupils truly are in the picture."""
    return camera.project(face.in_camera(face.pupils(motion.gaze), motion.head, motion.translation))


def exact_landmarks_px(motion: Motion, camera: Camera) -> Float[ndarray, "T L 2"]:
    """Where the landmarks truly are in the picture."""
    points = face.landmarks(motion.gaze, motion.lid, motion.jaw)
    return camera.project(face.in_camera(points, motion.head, motion.translation))


def observe(motion: Motion, camera: Camera, settings: NoiseSettings, random: np.random.Generator) -> Observation:
    """Landmarks and pupils as detectors would give them; confidence falls where the lids hide a pupil."""
    ahead = np.zeros_like(motion.gaze)
    ahead_px = camera.project(face.in_camera(face.pupils(ahead), motion.head, motion.translation))
    aperture = 1.0 - motion.lid
    yaw = motion.head[:, 1]
    openness = aperture.min(axis=1) / max(settings.pupil.hidden_below, 1e-9)
    return Observation(
        fps=motion.fps,
        landmarks=noisy_landmarks(exact_landmarks_px(motion, camera), yaw, motion.fps, settings.landmark, random),
        pupils=noisy_pupils(
            exact_pupils_px(motion, camera), ahead_px, yaw, aperture, motion.fps, settings.pupil, random
        ),
        confidence=np.clip(openness, 0.0, 1.0),
        camera=camera,
    )
