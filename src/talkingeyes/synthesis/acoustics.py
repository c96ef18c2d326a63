"""Simulated acoustics of a recording: room reverberation and background noise; motion and timing do not change.

The room follows Polack's model: white noise that decays by 60 dB over the reverberation time, after the direct sound
(Jeub et al. 2009, DSP, compare it with measured rooms). The noise has a spectrum of f^-k, with k sampled between white
(0) and brown (2), and a level that varies slowly. Pure functions with an explicit random generator.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field, model_validator
from scipy.signal import oaconvolve

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.settings import Settings, bounds_error

MAX_SPECTRAL_EXPONENT = 2.0
LOWEST_HZ = 40.0
WANDER_DB, WANDER_STEP_S = 3.0, 0.5
FIRST_ECHO_S = 0.002
PEAK = 0.97


class AcousticsSettings(Settings):
    """Probabilities and ranges of background noise and reverberation."""

    noise_probability: float = Field(ge=0, le=1)
    snr_min_db: float = Field(ge=-10, le=60)  # signal-to-noise ratio while speech sounds
    snr_max_db: float = Field(ge=-10, le=60)
    reverb_probability: float = Field(ge=0, le=1)
    rt60_min_s: float = Field(gt=0, le=5)  # time in which the reverberation falls by 60 dB
    rt60_max_s: float = Field(gt=0, le=5)
    drr_min_db: float = Field(ge=-20, le=40)  # direct-to-reverberant ratio
    drr_max_db: float = Field(ge=-20, le=40)

    @model_validator(mode="after")
    def _ordered(self) -> AcousticsSettings:
        for least, most in (("snr_min_db", "snr_max_db"), ("rt60_min_s", "rt60_max_s"),
                            ("drr_min_db", "drr_max_db")):  # fmt: skip
            if getattr(self, least) > getattr(self, most):
                raise bounds_error(f"{most} should be at least {least} ({getattr(self, least)})", getattr(self, most))
        return self


def apply_acoustics(
    sound: Float[ndarray, " N"], settings: AcousticsSettings, rng: np.random.Generator
) -> Float[ndarray, " N"]:
    """Simulate the recording of a sound: unchanged, reverberant, noisy, or both."""
    in_room, with_noise = rng.random(2) < (settings.reverb_probability, settings.noise_probability)
    if not in_room and not with_noise:
        return sound
    found = sound.astype(np.float64)
    if in_room:
        rt60_s = rng.uniform(settings.rt60_min_s, settings.rt60_max_s)
        found = add_reverb(found, rt60_s, rng.uniform(settings.drr_min_db, settings.drr_max_db), rng)
    if with_noise:
        level_db = rng.uniform(settings.snr_min_db, settings.snr_max_db)
        found = found + coloured_noise(len(found), rng) * _speech_rms(sound) * 10 ** (-level_db / 20)
    return np.asarray(found * min(1.0, PEAK / max(np.abs(found).max(), 1e-9)), np.float32)


def add_reverb(
    sound: Float[ndarray, " N"], rt60_s: float, drr_db: float, rng: np.random.Generator
) -> Float[ndarray, " N"]:
    """Add the reverberation of a room to a sound without delaying it."""
    times_s = np.arange(round(rt60_s * SAMPLE_RATE)) / SAMPLE_RATE
    echo = rng.standard_normal(len(times_s)) * 10 ** (-3.0 * times_s / rt60_s)
    echo[times_s < FIRST_ECHO_S] = 0.0
    echo *= 10 ** (-drr_db / 20) / np.sqrt(np.sum(echo**2))
    echo[0] = 1.0
    return np.asarray(oaconvolve(sound, echo)[: len(sound)])


def coloured_noise(samples: int, rng: np.random.Generator) -> Float[ndarray, " N"]:
    """Coloured noise of RMS 1 whose level varies by some decibels."""
    frequency_hz = np.maximum(np.fft.rfftfreq(samples, 1.0 / SAMPLE_RATE), LOWEST_HZ)
    spectrum = np.fft.rfft(rng.standard_normal(samples)) * frequency_hz ** (
        -rng.uniform(0.0, MAX_SPECTRAL_EXPONENT) / 2
    )
    steps = 2 + int(samples / SAMPLE_RATE / WANDER_STEP_S)
    wander_db = np.interp(np.linspace(0, steps - 1, samples), np.arange(steps), rng.normal(0.0, WANDER_DB, steps))
    made = np.fft.irfft(spectrum, samples) * 10 ** (wander_db / 20)
    return np.asarray(made / np.sqrt(np.mean(made**2)))


def _speech_rms(sound: Float[ndarray, " N"]) -> float:
    """RMS level of the samples that are not silent."""
    loud = sound[np.abs(sound) > 1e-4].astype(np.float64)
    return float(np.sqrt(np.mean(loud**2))) if len(loud) else 1.0
