"""Log-mel energies around each motion frame: the baseline for learned encoders."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import scipy.fft
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.audio.prosody import frame_signal
from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count
from talkingeyes.core.settings import ComponentSettings

FLOOR = 1e-8  # power; -80 dB


class LogmelSettings(ComponentSettings):
    """The Hann windows of a motion frame should cover it, so that no sound between frames is skipped."""

    kind: Literal["logmel"]
    bands: Annotated[int, Field(ge=8, le=128)]
    window_s: Annotated[float, Field(ge=0.016, le=0.2)]
    windows_per_frame: Annotated[int, Field(ge=1, le=4)]  # evenly over the frame; lips close for less than a frame


class LogmelEncoder:
    """A window and a mel filter bank."""

    settings_class = LogmelSettings

    def __init__(self, settings: LogmelSettings) -> None:
        size = round(settings.window_s * SAMPLE_RATE)
        self._fft_size = scipy.fft.next_fast_len(size, real=True)
        self._window = (np.hanning(size) / np.hanning(size).sum()).astype(np.float32)
        self._filters = mel_filters(settings.bands, self._fft_size)
        self._windows = settings.windows_per_frame
        self.channels = tuple(f"logmel_{index}" for index in range(self._windows * settings.bands))

    def __call__(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Natural logarithm of mel energies around the times t / fps, window by window."""
        return log_energies(self.energies(sound, fps))

    def lookahead_samples(self, fps: float) -> int:
        """Samples after (and before) the time of a frame that affect its energies."""
        offset_s = (self._windows - 1) / 2 / (fps * self._windows)
        return int(np.ceil(offset_s * SAMPLE_RATE)) + (len(self._window) + 1) // 2

    def energies(self, sound: Float[ndarray, " N"], fps: float) -> Float[ndarray, "T C"]:
        """Mel energies around the times t / fps, window by window."""
        count = frame_count(len(sound), fps)
        times_s = (np.arange(count * self._windows) - (self._windows - 1) / 2) / (fps * self._windows)
        energies = [np.zeros((0, self._filters.shape[0]), np.float32)]
        for frames in frame_signal(sound, times_s, len(self._window)):
            spectrum = scipy.fft.rfft(frames * self._window, self._fft_size)
            energies.append((np.square(np.abs(spectrum)) @ self._filters.T).astype(np.float32))
        return np.concatenate(energies).reshape(count, len(self.channels))


def log_energies(energies: Float[ndarray, "T C"]) -> Float[ndarray, "T C"]:
    """Natural logarithm of mel energies, with a floor."""
    return np.asarray(np.log(energies + np.float32(FLOOR)))


def mel_filters(bands: int, fft_size: int) -> Float[ndarray, "M F"]:
    """Triangular filters, evenly spaced on the mel scale (2595 log10(1 + f / 700)) from 0 to 8 kHz, with peak 1."""
    highest = 2595 * np.log10(1 + SAMPLE_RATE / 2 / 700)
    corners_hz = 700 * (10 ** (np.linspace(0, highest, bands + 2) / 2595) - 1)
    # A triangle narrower than a bin of the transform could fall between two bins, so each is at least one bin wide.
    bin_hz = SAMPLE_RATE / fft_size
    rise = np.maximum(np.diff(corners_hz), bin_hz)
    hz = np.arange(fft_size // 2 + 1) * bin_hz
    left = 1 - (corners_hz[1:-1, None] - hz) / rise[:-1, None]
    right = 1 - (hz - corners_hz[1:-1, None]) / rise[1:, None]
    return np.clip(np.minimum(left, right), 0, 1).astype(np.float32)
