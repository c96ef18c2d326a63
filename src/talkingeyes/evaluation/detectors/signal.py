"""What every detector asks of its input: frames at a usable rate, a second of them, numbers where they are seen.

Also the first step of each: which stretches of frames belong together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError

MIN_FPS, MAX_FPS = 10.0, 2000.0
MIN_SECONDS = 1.0
RAYLEIGH_MEDIAN = 1.1774  # median length of a step of white noise with standard deviation 1 in two axes


@dataclass(frozen=True)
class Runs:
    """N stretches of True: the first index of each, and the last."""

    first: Int[ndarray, " N"]
    last: Int[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.first)

    def where(self, kept: Bool[ndarray, " N"]) -> Runs:
        """Some of them."""
        return Runs(self.first[kept], self.last[kept])


def runs(flags: Bool[ndarray, " T"], split_at: Bool[ndarray, " T"] | None = None) -> Runs:
    """Stretches of True; where `split_at` is True a new one starts although the one before has not ended."""
    started = flags.copy()
    started[1:] &= ~flags[:-1] if split_at is None else ~flags[:-1] | split_at[1:]
    ended = flags.copy()
    ended[:-1] &= ~flags[1:] | started[1:]
    return Runs(np.flatnonzero(started), np.flatnonzero(ended))


def valid_frames(
    name: str, values: Float[ndarray, "T C"], fps: float, valid: Bool[ndarray, " T"] | None
) -> Bool[ndarray, " T"]:
    """Which frames count. Raises InputError on a rate out of range, too few frames, or NaN in a frame that counts."""
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
            f"{name}: holds NaN or infinite values in {wrong.sum()} frames, first in frame {int(wrong.argmax())}; "
            "mark such frames as not valid"
        )
    assert valid is not None
    return valid
