"""Input checks, runs of frames and timed events, common to all detectors.

Input must have a supported frame rate, last at least a second, and be finite in valid frames.
"""

from __future__ import annotations

from dataclasses import dataclass

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
