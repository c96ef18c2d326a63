"""Prosody at motion frames: log-energy, fundamental frequency and voicing, at any frame rate.

F0 is YIN (de Cheveigne and Kawahara 2002, JASA 111(4)): difference function, cumulative mean normalisation, absolute
threshold, parabolic interpolation. It is computed every 10 ms, filtered by a median over 50 ms (octave errors last one
or two steps), and sampled at the frame times. All steps are local in time, so long sounds are processed in blocks
without seams.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.fft
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from scipy.ndimage import median_filter

from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count
from talkingeyes.core.settings import Settings

STEP_S = 0.01
MEDIAN_STEPS = 5
BLOCK_FRAMES = 2048


class ProsodySettings(Settings):
    """Range and threshold of F0, and the window and floor of energy."""

    f0_min_hz: Annotated[float, Field(ge=40, le=200)]
    f0_max_hz: Annotated[float, Field(ge=200, le=1000)]
    yin_threshold: Annotated[float, Field(gt=0, lt=1)]  # YIN's absolute threshold: below it a step is voiced
    energy_window_s: Annotated[float, Field(ge=0.01, le=0.2)]
    energy_floor_dbfs: Annotated[float, Field(ge=-120, le=-40)]


@dataclass(frozen=True)
class Prosody:
    """Per motion frame: energy in dB re full scale, F0 in Hz (NaN where unvoiced), voicing as periodicity in 0..1."""

    energy_dbfs: Float[ndarray, " T"]
    f0_hz: Float[ndarray, " T"]
    voicing: Float[ndarray, " T"]


@dataclass(frozen=True)
class Pitch:
    """F0 (NaN where unvoiced) and aperiodicity (YIN's d': 0 periodic, about 1 noise), one value per step."""

    f0_hz: Float[ndarray, " K"]
    aperiodicity: Float[ndarray, " K"]


def prosody(sound: Float[ndarray, " N"], fps: float, settings: ProsodySettings) -> Prosody:
    """Prosody of a 16 kHz sound at the times t / fps."""
    times_s = np.arange(frame_count(len(sound), fps)) / fps
    pitch = yin(sound, settings)
    step = np.minimum(np.round(times_s / STEP_S).astype(int), len(pitch.f0_hz) - 1)
    return Prosody(
        energy_dbfs=energy_dbfs(sound, times_s, settings.energy_window_s, settings.energy_floor_dbfs),
        f0_hz=pitch.f0_hz[step],
        voicing=np.clip(1 - pitch.aperiodicity[step], 0, 1),
    )


def energy_dbfs(
    sound: Float[ndarray, " N"], times_s: Float[ndarray, " T"], window_s: float, floor_dbfs: float
) -> Float[ndarray, " T"]:
    """RMS level under a Hann window around each time, in dB re full scale, at least `floor_dbfs`."""
    window = np.hanning(round(window_s * SAMPLE_RATE)).astype(np.float32)
    window /= window.sum()
    power = [np.square(frames) @ window for frames in frame_signal(sound, times_s, len(window))]
    return np.asarray(10 * np.log10(np.maximum(np.concatenate([np.zeros(0), *power]), 10 ** (floor_dbfs / 10))))


def yin(sound: Float[ndarray, " N"], settings: ProsodySettings) -> Pitch:
    """Pitch every 10 ms."""
    max_lag = int(SAMPLE_RATE / settings.f0_min_hz) + 2
    times_s = np.arange(int(len(sound) / SAMPLE_RATE / STEP_S) + 1) * STEP_S
    pitches = [_yin_steps(frames, max_lag, settings) for frames in frame_signal(sound, times_s, 2 * max_lag)]
    f0 = np.concatenate([pitch.f0_hz for pitch in pitches])
    aperiodicity = np.concatenate([pitch.aperiodicity for pitch in pitches])
    # unvoiced steps are 0, so the median is also a majority vote on voicing
    smooth = median_filter(f0, MEDIAN_STEPS, mode="nearest")
    return Pitch(np.where(smooth > 0, smooth, np.nan), aperiodicity)


def _yin_steps(frames: Float[ndarray, "K W"], max_lag: int, settings: ProsodySettings) -> Pitch:
    """F0 (0 where unvoiced) and aperiodicity of each frame of length 2 * max_lag."""
    normalised = _normalised_difference(frames, max_lag)
    min_lag = int(SAMPLE_RATE / settings.f0_max_hz)
    inner = normalised[:, min_lag : max_lag - 1]
    valley = (inner <= normalised[:, min_lag - 1 : max_lag - 2]) & (inner < normalised[:, min_lag + 1 : max_lag])
    below = valley & (inner < settings.yin_threshold)
    lag = min_lag + np.where(below.any(axis=1), below.argmax(axis=1), inner.argmin(axis=1))
    rows = np.arange(len(frames))
    before, at, after = (normalised[rows, lag + k] for k in (-1, 0, 1))
    curvature = before - 2 * at + after
    shift = np.where(curvature > 1e-9, 0.5 * (before - after) / np.maximum(curvature, 1e-9), 0)
    f0 = SAMPLE_RATE / (lag + np.clip(shift, -0.5, 0.5))
    return Pitch(np.where(at < settings.yin_threshold, f0, 0), at)


def _normalised_difference(frames: Float[ndarray, "K W"], max_lag: int) -> Float[ndarray, "K L"]:
    """YIN's d' for lags 0 to max_lag - 1: squared difference of the first half and its shift, over its running mean."""
    frames = frames - frames.mean(axis=1, keepdims=True)
    half = frames[:, :max_lag]
    size = scipy.fft.next_fast_len(frames.shape[1], real=True)
    spectrum = scipy.fft.rfft(frames, size) * np.conj(scipy.fft.rfft(half, size))
    correlation = scipy.fft.irfft(spectrum, size)[:, :max_lag]
    energy = np.cumsum(np.pad(np.square(frames, dtype=np.float64), ((0, 0), (1, 0))), axis=1)
    shifted = energy[:, max_lag : 2 * max_lag] - energy[:, :max_lag]
    difference = np.maximum(shifted[:, :1] + shifted - 2 * correlation, 0)
    lags = np.arange(1, max_lag)
    mean = np.cumsum(difference[:, 1:], axis=1) / lags
    silence = 1e-9 * max_lag  # below about -90 dBFS nothing is periodic
    return np.concatenate([np.ones((len(frames), 1)), (difference[:, 1:] + silence) / (mean + silence)], axis=1)


def frame_signal(
    sound: Float[ndarray, " N"], centres_s: Float[ndarray, " T"], size: int
) -> Iterator[Float[ndarray, "K W"]]:
    """Windows of `size` samples around ascending times, zero-padded, in blocks of bounded memory."""
    for first in range(0, len(centres_s), BLOCK_FRAMES):
        starts = np.round(centres_s[first : first + BLOCK_FRAMES] * SAMPLE_RATE).astype(int) - size // 2
        begin, end = int(starts[0]), int(starts[-1]) + size
        around = np.pad(sound[max(begin, 0) : max(end, 0)], (max(-begin, 0), max(end - len(sound), 0)))
        yield around[starts[:, None] - begin + np.arange(size)]
