"""Random windows of recordings as training batches: any frame offset, mirrored half of the time if asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.corpus.windows import Recording
from talkingeyes.errors import InputError
from talkingeyes.models.gaze.signal import mirrored
from talkingeyes.models.layers import share
from talkingeyes.models.speech_to_motion import Batch
from talkingeyes.settings import Settings


class WindowSettings(Settings):
    """What a training window is."""

    # Frames of a window.
    frames: Annotated[int, Field(gt=1)]
    # Mirror half of the windows (left and right change places): people do not differ by that, and it doubles the data.
    mirror: bool


@dataclass(frozen=True)
class MotionStatistics:
    """One mean a number and one scale for all (LEARNING: rotation z of the eyes is constant)."""

    mean: Float[ndarray, " F"]
    scale: float


def statistics(frames: Float[ndarray, "N F"]) -> MotionStatistics:
    """Mean a number, and the root mean square deviation of the numbers that vary."""
    mean = frames.mean(0)
    deviation = (frames - mean).std(0)
    varying = deviation[deviation > 1e-4]
    return MotionStatistics(mean, float(np.sqrt((varying**2).mean())) if len(varying) else 1.0)


@dataclass(frozen=True)
class _Window:
    """A recording, the first frame, and whether it is mirrored."""

    index: int
    start: int
    mirrored: bool


class Windows:
    """Draws batches from recordings. Clips shorter than a window are left out."""

    def __init__(self, recordings: Sequence[Recording], settings: WindowSettings, seed: int) -> None:
        self.recordings, self.settings = recordings, settings
        self.random = np.random.default_rng(seed)
        lengths = np.array([len(recording) for recording in recordings])
        self.long_enough = np.flatnonzero(lengths >= settings.frames)
        if not len(self.long_enough):
            raise InputError(
                f"no training clip has {settings.frames} frames, the longest has {lengths.max()}: shorten the window"
            )
        # A long clip gives more windows than a short one.
        self.lengths = lengths[self.long_enough] / lengths[self.long_enough].sum()

    def draw(self, batch: int) -> Batch:
        """A batch of windows; of several processes, each draws the same batch and cuts its own share of it."""
        drawn = [self._drawn(int(index)) for index in self.random.choice(self.long_enough, batch, p=self.lengths)]
        speech, head, gaze = zip(*map(self._cut, share.own(drawn)), strict=True)
        return Batch(*(torch.from_numpy(np.stack(part)) for part in (speech, head, gaze)))

    def _drawn(self, index: int) -> _Window:
        start = int(self.random.integers(len(self.recordings[index]) - self.settings.frames + 1))
        return _Window(index, start, self.settings.mirror and self.random.random() < 0.5)

    def _cut(self, window: _Window) -> tuple[ndarray, ...]:
        recording = self.recordings[window.index]
        part = slice(window.start, window.start + self.settings.frames)
        head, gaze = recording.head[part], recording.gaze[part]
        if window.mirrored:
            head, gaze = mirrored(head, gaze)
        return np.asarray(recording.speech[part]), head, gaze
