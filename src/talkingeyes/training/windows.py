"""Random windows of recordings as training batches, at any frame offset and optionally mirrored."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass
from typing import Annotated, Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.recordings import Recording
from talkingeyes.models.gaze.gaze_signal import mirror_motion
from talkingeyes.models.layers import distributed
from talkingeyes.models.speech_to_motion import MotionBatch
from talkingeyes.training.conditioning import ConditioningProvider, collate_inputs

AnyRecording = TypeVar("AnyRecording", bound=Sized)
Batch = TypeVar("Batch")


class WindowSettings(Settings):
    """Settings of training windows."""

    # Frames of a window; null: whole clips, each once an epoch in random order, with a batch of 1.
    frames: Annotated[int, Field(gt=1)] | None
    # Mirror half of the windows (swap left and right). People do not differ by side, and it doubles the data.
    mirror: bool


@dataclass(frozen=True)
class MotionStatistics:
    """One mean per dimension and one scale for all (rotation z of the eyes is constant, so it has no scale of its
    own)."""

    mean: Float[ndarray, " F"]
    scale: float


def motion_statistics(frames: Float[ndarray, "N F"]) -> MotionStatistics:
    """Mean per dimension, and the root mean square of the standard deviations of the dimensions that vary."""
    mean = frames.mean(0)
    deviation = (frames - mean).std(0)
    varying = deviation[deviation > 1e-4]
    return MotionStatistics(mean, float(np.sqrt((varying**2).mean())) if len(varying) else 1.0)


@dataclass(frozen=True)
class Window(Generic[AnyRecording]):
    """A range of frames of a recording, and whether they are mirrored."""

    recording: AnyRecording
    frames: slice
    mirrored: bool


class WindowDataset(Generic[AnyRecording, Batch]):
    """Samples batches of windows of recordings, in proportion to length, or of whole recordings in epochs.

    `collate` reads the windows of a batch. Recordings shorter than a window are excluded.
    """

    def __init__(
        self,
        recordings: Sequence[AnyRecording],
        settings: WindowSettings,
        seed: int,
        collate: Callable[[Sequence[Window[AnyRecording]]], Batch],
    ) -> None:
        """Raises InputError if no recording is long enough."""
        self.recordings, self.settings, self.seed, self.collate = recordings, settings, seed, collate
        self.rng = np.random.default_rng(seed)
        self.lengths = np.array([len(each) for each in recordings])
        self.long_enough = np.flatnonzero(self.lengths >= (settings.frames or 2))
        if not len(self.long_enough):
            longest = self.lengths.max()
            raise InputError(
                f"windows.frames: should be at most {longest} (the longest training clip), got {settings.frames}"
            )
        self.probabilities = self.lengths[self.long_enough] / self.lengths[self.long_enough].sum()

    def sample_batch(self, batch: int, step: int) -> Batch:
        """Sample the batch of a step (from 1). All processes sample the same batch and take their own rows.

        Raises InputError for more than one whole recording.
        """
        if self.settings.frames is not None:
            chosen = self.rng.choice(self.long_enough, batch, p=self.probabilities)
        elif batch == 1:
            epoch, place = divmod(step - 1, len(self.long_enough))
            chosen = np.random.default_rng((self.seed, epoch)).permutation(self.long_enough)[[place]]
        else:
            raise InputError(f"loop.batch: should be 1 for whole clips (windows.frames=null), got {batch}")
        ranges = distributed.local_rows([(int(index), self._sample_range(int(index))) for index in chosen])
        return self.collate([Window(self.recordings[index], frames, mirror) for index, (frames, mirror) in ranges])

    def _sample_range(self, index: int) -> tuple[slice, bool]:
        length = self.settings.frames or int(self.lengths[index])
        start = int(self.rng.integers(self.lengths[index] - length + 1))
        return slice(start, start + length), self.settings.mirror and self.rng.random() < 0.5


def motion_batch(conditioning_provider: ConditioningProvider, windows: Sequence[Window[Recording]]) -> MotionBatch:
    """Windows of head and gaze with their speech and conditioning inputs."""
    rows = zip(*map(_read_motion, windows), strict=True)
    speech, head, gaze = (torch.from_numpy(np.stack(part)) for part in rows)
    conditioning = [conditioning_provider.window(each.recording.clip, each.frames, each.mirrored) for each in windows]
    return MotionBatch(speech, head, gaze, collate_inputs(conditioning))


def _read_motion(window: Window[Recording]) -> tuple[ndarray, ndarray, ndarray]:
    recording, part = window.recording, window.frames
    head, gaze = recording.head[part], recording.gaze[part]
    return np.asarray(recording.speech[part]), *(mirror_motion(head, gaze) if window.mirrored else (head, gaze))
