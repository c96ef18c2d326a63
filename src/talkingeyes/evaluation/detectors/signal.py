"""What detectors and measures share: input checks, runs of frames, timed events; power spectra.

Input must have a supported frame rate, last at least a second, and be finite in valid frames.

Spectra are Welch's (1967), with their summaries: slope, power above 5 Hz, distance in decibels. Human eyes and heads
have little power above 5 Hz apart from saccades, so jitter and oversmoothing both show there. The steps of gaze give
its spectrum a slope of about -2 (a saccade is a step). The spectrum of a clip is a sum over segments, so clips are
resampled without keeping their frames. Frames are point samples: a saccade faster than a frame aliases into the band,
in truth and samples alike, so compare only spectra at the same frame rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError

MIN_FPS, MAX_FPS = 10.0, 2000.0
MIN_SECONDS = 1.0
RAYLEIGH_MEDIAN = 1.1774  # median norm of 2-D white noise with standard deviation 1 on each axis


@dataclass(frozen=True)
class Runs:
    """N runs of True: the first and the last index of each."""

    first: Int[ndarray, " N"]
    last: Int[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.first)

    def where(self, kept: Bool[ndarray, " N"]) -> Runs:
        """The selected runs."""
        return Runs(self.first[kept], self.last[kept])


def runs(flags: Bool[ndarray, " T"], split_at: Bool[ndarray, " T"] | None = None) -> Runs:
    """Runs of True; `split_at` starts a new run even if the previous one has not ended."""
    started = flags.copy()
    started[1:] &= ~flags[:-1] if split_at is None else ~flags[:-1] | split_at[1:]
    ended = flags.copy()
    ended[:-1] &= ~flags[1:] | started[1:]
    return Runs(np.flatnonzero(started), np.flatnonzero(ended))


@dataclass(frozen=True)
class TimedEvents:
    """N events in order of time."""

    onset_s: Float[ndarray, " N"]
    offset_s: Float[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.onset_s)

    @property
    def duration_s(self) -> Float[ndarray, " N"]:
        """Time from onset to offset."""
        return np.asarray(self.offset_s - self.onset_s)


def valid_frames(
    name: str, values: Float[ndarray, "T C"], fps: float, valid: Bool[ndarray, " T"] | None
) -> Bool[ndarray, " T"]:
    """Mask of valid frames.

    Raises InputError for a frame rate out of range, too few frames, or values that are not finite in a valid frame.
    """
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError(f"{name}: fps should be between {MIN_FPS:g} and {MAX_FPS:g}, got {fps:g}")
    if len(values) < MIN_SECONDS * fps:
        raise InputError(
            f"{name}: should last {MIN_SECONDS:g} s or more ({MIN_SECONDS * fps:.0f} frames at {fps:g} fps), "
            f"got {len(values)} frames"
        )
    finite = np.isfinite(values).all(axis=1)
    if finite.all():
        return finite if valid is None else valid
    wrong = ~finite if valid is None else ~finite & valid
    if wrong.any():
        raise InputError(
            f"{name}: should be finite in valid frames, got NaN or infinite values in {wrong.sum()} frames, "
            f"first in frame {int(wrong.argmax())}; mark such frames as invalid"
        )
    assert valid is not None
    return valid


SEGMENT_S = 2.56
HIGH_HZ = 5.0
SLOPE_BAND_HZ = (0.5, 5.0)
# Degrees squared per hertz: below this is rounding error of motionless clips (1e-26).
ZERO_TOLERANCE = 1e-18


@dataclass(frozen=True)
class Spectrum:
    """Sum over segments of power density per channel (degrees squared per hertz), and the number of segments."""

    frequency_hz: Float[ndarray, " F"]
    power: Float[ndarray, "F C"]
    segments: float


def spectrum(angles_rad: Float[ndarray, "T C"], fps: float, valid: Bool[ndarray, " T"] | None = None) -> Spectrum:
    """Spectrum of one clip: half-overlapping Hann windows, linearly detrended; segments with gaps are left out.

    Without detrending, a head turn across a segment would leak into every frequency. Motionless clips have zero power.
    """
    size = round(SEGMENT_S * fps)
    frequency_hz, time, window = _segment(size, fps)
    starts = np.arange(0, len(angles_rad) - size + 1, size // 2)
    index = starts[:, None] + np.arange(size)
    if valid is not None:
        index = index[valid[index].all(axis=1)] if len(index) else index
    cut = np.degrees(angles_rad)[index]
    spectral_slope = np.einsum("t,stc->sc", time, cut) / (time @ time)
    straight = cut - cut.mean(axis=1, keepdims=True) - time[:, None] * spectral_slope[:, None]
    transform = np.fft.rfft(straight * window[:, None], axis=1)
    power = (2 * np.square(np.abs(transform)) / (fps * np.square(window).sum())).sum(axis=0)
    return Spectrum(frequency_hz, np.where(power > ZERO_TOLERANCE, power, 0.0), float(len(index)))


@cache
def _segment(size: int, fps: float) -> tuple[Float[ndarray, " F"], Float[ndarray, " T"], Float[ndarray, " T"]]:
    """Frequencies, frame numbers relative to the middle, and window of a segment."""
    return np.fft.rfftfreq(size, 1 / fps), np.arange(size) - (size - 1) / 2, np.hanning(size + 1)[:-1]
