"""Renders events and continuous motion at any frame rate by point sampling.

Everything is a closed-form function of time, so frames at 25 fps are every fourth frame of those at 100; nothing is
filtered or decimated. Continuous parts are sums of sinusoids: the head's slow, ordinary and rapid bands (Hadar 1983),
its small translation, and the drift of the lids.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Phoneme
from talkingeyes.core import rotation
from talkingeyes.core.motion import Events, Motion
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.physiology import articulation, blinks, eye_head, face, lids, saccades, vergence


@dataclass(frozen=True)
class Sinusoids:
    """A sum of K sinusoids in C channels."""

    frequency_hz: Float[ndarray, " K"]
    amplitude: Float[ndarray, "K C"]
    phase_rad: Float[ndarray, "K C"]

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T C"]:
        """Values at times, computed as two matrix products (cos(a + b) = cos a cos b - sin a sin b)."""
        angle = 2.0 * np.pi * times_s[:, None] * self.frequency_hz
        in_phase, in_quadrature = self.amplitude * np.cos(self.phase_rad), self.amplitude * np.sin(self.phase_rad)
        return np.asarray(np.cos(angle) @ in_phase - np.sin(angle) @ in_quadrature)


@dataclass(frozen=True)
class PiecewiseLinear:
    """A polyline in time, constant beyond its ends."""

    knots_s: Float[ndarray, " K"]
    values: Float[ndarray, " K"]

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """Values at times."""
        return np.asarray(np.interp(times_s, self.knots_s, self.values))


@dataclass(frozen=True)
class ContinuousMotion:
    """Continuous motion apart from events.

    `gaze_rest_rad` is (yaw, pitch) of gaze in space without saccades. `head_speech_motion` is head motion that scales
    with `activity` (0 still, 1 speaking). `lid_rest` is a closure apart from blinks, `lid_drift` the slow motion of the
    lids (radians), `emotion_fluctuation` the relative change of the emotion's strength. `kappa_rad` is the angle from
    the line of sight to the optical axis of each eye (yaw, pitch), `blink_lag_s` the delay of the right lid after the
    left.
    """

    gaze_rest_rad: tuple[float, float]
    kappa_rad: Float[ndarray, "2 2"]
    head_rest: Float[ndarray, " 3"]
    head_drift: Sinusoids
    head_speech_motion: Sinusoids
    activity: PiecewiseLinear
    translation: Sinusoids
    eyelids: tuple[EyelidParameters, EyelidParameters]
    lid_rest: float
    lid_drift: Sinusoids
    blink_lag_s: float
    phonemes: Sequence[Phoneme]
    mouth: articulation.ArticulationStyle
    face: face.FacialBehaviour
    emotion_fluctuation: Sinusoids


def head_rotations(
    events: Events, continuous_motion: ContinuousMotion, times_s: Float[ndarray, " T"]
) -> Float[ndarray, "T 3"]:
    """Head rotation vectors: rest, continuous motion, and the sum of the head movements."""
    speaking = continuous_motion.activity.at(times_s)[:, None] * continuous_motion.head_speech_motion.at(times_s)
    moves = eye_head.head_path(events.head_movements, times_s)
    return np.asarray(continuous_motion.head_rest + continuous_motion.head_drift.at(times_s) + speaking + moves)


def render(events: Events, continuous_motion: ContinuousMotion, times_s: Float[ndarray, " T"], fps: float) -> Motion:
    """Render the state at ascending times; `fps` is stored in the Motion."""
    turned = head_rotations(events, continuous_motion, times_s)
    gaze_space = saccades.gaze_path(events.saccades, continuous_motion.gaze_rest_rad, times_s)
    lags_s = (-continuous_motion.blink_lag_s / 2.0, continuous_motion.blink_lag_s / 2.0)
    shut = np.stack([blinks.blink_closure(events.blinks, times_s - lag) for lag in lags_s], axis=-1)
    turned_in = vergence.vergence_path(events.vergence_movements, events.saccades, times_s)
    gaze = eye_head.eye_rotations(
        turned, gaze_space, turned_in, continuous_motion.kappa_rad, blinks.blink_eye_rotation_rad(shut)
    )
    mouth = articulation.mouth_motion(continuous_motion.phonemes, times_s, continuous_motion.mouth)
    strength_over_time = 1.0 + continuous_motion.emotion_fluctuation.at(times_s)[:, 0]
    behind = gaze_space - saccades.gaze_path(events.saccades, continuous_motion.gaze_rest_rad, times_s - lids.LID_LAG_S)
    return Motion.of(
        fps=fps,
        head=turned,
        gaze=gaze,
        translation=continuous_motion.translation.at(times_s),
        lid=lids.add_blinks(_open_lids(continuous_motion, gaze, behind[:, 1], times_s, strength_over_time), shut),
        jaw=mouth.jaw,
        expression=face.expression_weights(continuous_motion.face, mouth, times_s, strength_over_time),
        expression_names=face.FACE_SHAPES,
    )


def _open_lids(
    continuous_motion: ContinuousMotion,
    gaze: Float[ndarray, "T 2 3"],
    behind_rad: Float[ndarray, " T"],
    times_s: Float[ndarray, " T"],
    strength_over_time: Float[ndarray, " T"],
) -> Float[ndarray, "T 2"]:
    """Lids without blinks: they follow the eyes, delayed by `behind_rad`, plus offsets of person and emotion."""
    angles = rotation.gaze_to_angles(gaze)
    followed = angles[..., 1] - behind_rad[:, None]
    open_ = lids.lid_closure_by_gaze(
        angles, followed, continuous_motion.lid_drift.at(times_s), continuous_motion.eyelids
    )
    rest = (
        continuous_motion.lid_rest
        + continuous_motion.face.emotion_expression.lid * continuous_motion.face.share * strength_over_time[:, None]
    )
    return np.clip(open_ + rest, lids.MIN_CLOSURE, lids.MAX_CLOSURE)


def render_at(events: Events, continuous_motion: ContinuousMotion, fps: float, frames: int) -> Motion:
    """Render frames 0 to `frames` at `fps`: frame t is the state at t / fps."""
    return render(events, continuous_motion, np.arange(frames) / fps, fps)
