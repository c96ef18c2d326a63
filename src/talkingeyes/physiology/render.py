"""A performance as events and continuous parts, rendered at any frame rate by point sampling.

Everything is a closed function of time, so frames at 25 a second are every fourth frame of those at 100; nothing is
ever filtered or decimated. Continuous parts are sums of sinusoids: the head's slow, ordinary and rapid bands (Hadar
1983), its small translation, and the unrest of the lids.
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
from talkingeyes.head.eyelid.anatomy import Person
from talkingeyes.physiology import articulation, blinks, eye_head, face, lids, saccades, vergence


@dataclass(frozen=True)
class Waves:
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
class Curve:
    """A polyline in time, constant beyond its ends."""

    knots_s: Float[ndarray, " K"]
    values: Float[ndarray, " K"]

    def at(self, times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
        """Values at times."""
        return np.asarray(np.interp(times_s, self.knots_s, self.values))


@dataclass(frozen=True)
class Continuous:
    """What moves all the time, beside the events.

    `gaze_rest_rad` is (yaw, pitch) of gaze in space where there is no saccade; `head_speaking` is the unrest of the
    head that grows with `activity` (0 still, 1 speaking); `lid_rest` is a closure beside the blinks, `lid_unrest` the
    slow motion of the lids (radians), `face_tide` how much more or less of an emotion shows;
    `kappa_rad` is what each eye's optical axis (yaw, pitch) has over its line of sight, `blink_lag_s` how much later
    the right lid moves than the left.
    """

    gaze_rest_rad: tuple[float, float]
    kappa_rad: Float[ndarray, "2 2"]
    head_rest: Float[ndarray, " 3"]
    head_waves: Waves
    head_speaking: Waves
    activity: Curve
    translation: Waves
    eyelids: tuple[Person, Person]
    lid_rest: float
    lid_unrest: Waves
    blink_lag_s: float
    phonemes: Sequence[Phoneme]
    mouth: articulation.MouthHabit
    face: face.Face
    face_tide: Waves


def head(events: Events, continuous: Continuous, times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 3"]:
    """Head rotation vectors: rest, unrest, and the sum of the head movements."""
    speaking = continuous.activity.at(times_s)[:, None] * continuous.head_speaking.at(times_s)
    moves = eye_head.head_path(events.head_moves, times_s)
    return np.asarray(continuous.head_rest + continuous.head_waves.at(times_s) + speaking + moves)


def render(events: Events, continuous: Continuous, times_s: Float[ndarray, " T"], fps: float) -> Motion:
    """The state at each of the ascending times; `fps` is what the Motion says of itself."""
    turned = head(events, continuous, times_s)
    gaze_space = saccades.path(events.saccades, continuous.gaze_rest_rad, times_s)
    lags_s = (-continuous.blink_lag_s / 2.0, continuous.blink_lag_s / 2.0)
    shut = np.stack([blinks.closure(events.blinks, times_s - lag) for lag in lags_s], axis=-1)
    turned_in = vergence.vergence_path(events.refocuses, events.saccades, times_s)
    gaze = eye_head.eyes(turned, gaze_space, turned_in, continuous.kappa_rad, blinks.eye_shift_rad(shut))
    mouth = articulation.mouth(continuous.phonemes, times_s, continuous.mouth)
    tide = 1.0 + continuous.face_tide.at(times_s)[:, 0]
    behind = gaze_space - saccades.path(events.saccades, continuous.gaze_rest_rad, times_s - lids.LATE_S)
    return Motion.of(
        fps=fps,
        head=turned,
        gaze=gaze,
        translation=continuous.translation.at(times_s),
        lid=lids.blinking(_open_lids(continuous, gaze, behind[:, 1], times_s, tide), shut),
        jaw=mouth.jaw,
        expression=face.expression(continuous.face, mouth, times_s, tide),
        expression_names=face.FACE_SHAPES,
    )


def _open_lids(
    continuous: Continuous,
    gaze: Float[ndarray, "T 2 3"],
    behind_rad: Float[ndarray, " T"],
    times_s: Float[ndarray, " T"],
    tide: Float[ndarray, " T"],
) -> Float[ndarray, "T 2"]:
    """Lids without blinks: they follow the eyes, `behind_rad` late; person and mood say where they rest."""
    angles = rotation.angles_of_gaze(gaze)
    followed = angles[..., 1] - behind_rad[:, None]
    open_ = lids.open_lids(angles, followed, continuous.lid_unrest.at(times_s), continuous.eyelids)
    rest = continuous.lid_rest + continuous.face.feeling.lid * continuous.face.share * tide[:, None]
    return np.clip(open_ + rest, lids.WIDEST, lids.OPEN_MOST)


def render_at(events: Events, continuous: Continuous, fps: float, frames: int) -> Motion:
    """Frames 0 to `frames` at `fps`: frame t is the state at t / fps."""
    return render(events, continuous, np.arange(frames) / fps, fps)
