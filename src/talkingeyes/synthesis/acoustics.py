"""What the microphone adds: a room's echo and background noise, to the sound alone; motion and times stay.

The room is Polack's model: white noise that decays by 60 dB in the reverberation time, behind the direct sound
(Jeub et al. 2009, DSP, compare it with measured rooms). The noise has a spectrum of f^-k, k drawn from white (0) to
brown (2), and a level that wanders. Pure: takes a generator.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field, model_validator
from scipy.signal import oaconvolve

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.settings import Settings, out_of_bounds

STEEPEST = 2.0
LOWEST_HZ = 40.0
WANDER_DB, WANDER_STEP_S = 3.0, 0.5
FIRST_ECHO_S = 0.002
PEAK = 0.97


class AcousticsSettings(Settings):
    """How many of the sounds are heard with noise or in a room, and how much of it."""

    noise_share: float = Field(ge=0, le=1)
    noise_least_db: float = Field(ge=-10, le=60)  # speech over noise, while speech sounds
    noise_most_db: float = Field(ge=-10, le=60)
    room_share: float = Field(ge=0, le=1)
    decay_least_s: float = Field(gt=0, le=5)  # in which the room's sound falls by 60 dB
    decay_most_s: float = Field(gt=0, le=5)
    direct_least_db: float = Field(ge=-20, le=40)  # direct sound over echo
    direct_most_db: float = Field(ge=-20, le=40)

    @model_validator(mode="after")
    def _ordered(self) -> AcousticsSettings:
        for least, most in (("noise_least_db", "noise_most_db"), ("decay_least_s", "decay_most_s"),
                            ("direct_least_db", "direct_most_db")):  # fmt: skip
            if getattr(self, least) > getattr(self, most):
                raise out_of_bounds(f"{most} should be at least {least} ({getattr(self, least)})", getattr(self, most))
        return self


def heard(
    sound: Float[ndarray, " N"], settings: AcousticsSettings, random: np.random.Generator
) -> Float[ndarray, " N"]:
    """The sound as the microphone gets it: as it is, or in a room, with noise, or both."""
    in_room, with_noise = random.random(2) < (settings.room_share, settings.noise_share)
    if not in_room and not with_noise:
        return sound
    found = sound.astype(np.float64)
    if in_room:
        decay_s = random.uniform(settings.decay_least_s, settings.decay_most_s)
        found = in_a_room(found, decay_s, random.uniform(settings.direct_least_db, settings.direct_most_db), random)
    if with_noise:
        level_db = random.uniform(settings.noise_least_db, settings.noise_most_db)
        found = found + noise(len(found), random) * _speech_rms(sound) * 10 ** (-level_db / 20)
    return np.asarray(found * min(1.0, PEAK / max(np.abs(found).max(), 1e-9)), np.float32)


def in_a_room(
    sound: Float[ndarray, " N"], decay_s: float, direct_db: float, random: np.random.Generator
) -> Float[ndarray, " N"]:
    """The sound with the echo of a room, not shifted in time."""
    times_s = np.arange(round(decay_s * SAMPLE_RATE)) / SAMPLE_RATE
    echo = random.standard_normal(len(times_s)) * 10 ** (-3.0 * times_s / decay_s)
    echo[times_s < FIRST_ECHO_S] = 0.0
    echo *= 10 ** (-direct_db / 20) / np.sqrt(np.sum(echo**2))
    echo[0] = 1.0
    return np.asarray(oaconvolve(sound, echo)[: len(sound)])


def noise(samples: int, random: np.random.Generator) -> Float[ndarray, " N"]:
    """Coloured noise of RMS 1, its level wandering by some decibels."""
    frequency_hz = np.maximum(np.fft.rfftfreq(samples, 1.0 / SAMPLE_RATE), LOWEST_HZ)
    spectrum = np.fft.rfft(random.standard_normal(samples)) * frequency_hz ** (-random.uniform(0.0, STEEPEST) / 2)
    steps = 2 + int(samples / SAMPLE_RATE / WANDER_STEP_S)
    wander_db = np.interp(np.linspace(0, steps - 1, samples), np.arange(steps), random.normal(0.0, WANDER_DB, steps))
    made = np.fft.irfft(spectrum, samples) * 10 ** (wander_db / 20)
    return np.asarray(made / np.sqrt(np.mean(made**2)))


def _speech_rms(sound: Float[ndarray, " N"]) -> float:
    """The level while speech sounds: of what is not silence."""
    loud = sound[np.abs(sound) > 1e-4].astype(np.float64)
    return float(np.sqrt(np.mean(loud**2))) if len(loud) else 1.0
