"""Pupils in pixels: projection compared with the vertices of the head, and simulation of Gaze360 (paper, Table VIII).

No appearance-based estimator is part of the project, so its row is simulated: true gaze with a gain, a constant error
in each clip, a drifting error and a little white noise. Their sizes are chosen to give the error of Gaze360 in the
paper. The row shows that such an error is consistent with such a speed; it does not evaluate an estimator.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.signal import lfilter

from talkingeyes.core.motion import Events, Motion
from talkingeyes.core.rotation import angles_to_gaze, gaze_to_angles
from talkingeyes.fitting.accuracy import FitReference
from talkingeyes.fitting.comparison import blink_frames
from talkingeyes.head import landmarks as face
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.observation import Observation

PX_PER_RAD = 15.35  # of the eye, in a crop of 224 pixels
GAIN, AUTOCORRELATION = (0.85, 1.0), 0.999
CONSTANT_RAD, DRIFT_RAD, WHITE_RAD = 0.85 / PX_PER_RAD, 0.45 / PX_PER_RAD, 0.014 / PX_PER_RAD


def projected_px(camera: Camera) -> float:
    """Largest distance in pixels between pupils by formula and by the vertices of the head, looking straight ahead."""
    head = anny_head()
    by_formula = camera.project(face.pupil_centres(np.zeros((1, 2, 3))))
    on_head = camera.project(np.asarray(head.template[head.pupils], np.float64)[None])
    return float(np.linalg.norm(by_formula - on_head, axis=-1).max())


def simulate_gaze360(
    truth: Motion, events: Events, seen: Observation, rng: np.random.Generator
) -> Float[ndarray, "1 4"]:
    """Summed error and count, and summed speed of the simulated gaze and of the truth, for one clip."""
    frames = len(truth)
    frame_mask = ~blink_frames(events, frames, truth.fps)
    reference = FitReference(pupils=seen.pupils, camera=seen.camera, frame_mask=frame_mask, pose=truth, truth=truth)
    angles = rng.uniform(*GAIN) * gaze_to_angles(truth.gaze) + _slow(frames, rng)[:, None]
    angles = angles + WHITE_RAD * rng.standard_normal(angles.shape)
    found, true = (reference.error_sums(each) for each in (_with_gaze(truth, angles), truth))
    return np.array([[found.truth_distance_px, found.truth_distances, found.speed_px_s, true.speed_px_s]])


def _slow(frames: int, rng: np.random.Generator) -> Float[ndarray, "T 2"]:
    """A constant plus a first-order autoregressive drift that starts in its steady state."""
    noise = rng.standard_normal((frames, 2)) * np.sqrt(1 - AUTOCORRELATION**2)
    noise[0] = rng.standard_normal(2)
    drift = lfilter([1.0], [1.0, -AUTOCORRELATION], noise, axis=0)
    return np.asarray(CONSTANT_RAD * rng.standard_normal(2) + DRIFT_RAD * drift)


def _with_gaze(motion: Motion, angles_rad: Float[ndarray, "T 2 2"]) -> Motion:
    return Motion.of(fps=motion.fps, head=motion.head, gaze=angles_to_gaze(angles_rad), translation=motion.translation)
