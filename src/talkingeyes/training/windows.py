"""Random windows of recordings as training batches, at any frame offset and optionally mirrored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.recordings import Recording
from talkingeyes.models.condition.conditioner import NO_CONDITIONING
from talkingeyes.models.gaze.gaze_signal import mirror_motion
from talkingeyes.models.layers import distributed
from talkingeyes.models.speech_to_motion import MotionBatch
from talkingeyes.training.conditioning import ConditioningProvider, WindowInputs, collate_inputs


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
class Window:
    """Index of a recording, a range of its frames, and whether they are mirrored."""

    index: int
    frames: slice
    mirrored: bool


class WindowSampler:
    """Samples windows of clips of given lengths, in proportion to length, or whole clips in epochs. Clips shorter than
    a window are excluded."""

    def __init__(self, lengths: Int[ndarray, " M"], settings: WindowSettings, seed: int) -> None:
        """Raises InputError if no clip is long enough."""
        self.settings, self.seed, self.frames = settings, seed, lengths
        self.rng = np.random.default_rng(seed)
        self.long_enough = np.flatnonzero(lengths >= (settings.frames or 2))
        if not len(self.long_enough):
            raise InputError(
                f"windows.frames: should be at most {lengths.max()} (the longest training clip), got {settings.frames}"
            )
        self.probabilities = lengths[self.long_enough] / lengths[self.long_enough].sum()

    def sample_batch(self, batch: int, step: int) -> list[Window]:
        """Sample the batch of a step (from 1). All processes sample the same batch and take their own rows.

        Raises InputError for more than one whole clip.
        """
        if self.settings.frames is not None:
            chosen = self.rng.choice(self.long_enough, batch, p=self.probabilities)
        elif batch == 1:
            epoch, place = divmod(step - 1, len(self.long_enough))
            chosen = np.random.default_rng((self.seed, epoch)).permutation(self.long_enough)[[place]]
        else:
            raise InputError(f"loop.batch: should be 1 for whole clips (windows.frames=null), got {batch}")
        return distributed.local_rows([self._sample_window(int(index)) for index in chosen])

    def _sample_window(self, index: int) -> Window:
        length = self.settings.frames or int(self.frames[index])
        start = int(self.rng.integers(self.frames[index] - length + 1))
        mirrored = self.settings.mirror and self.rng.random() < 0.5
        return Window(index, slice(start, start + length), mirrored)


class MotionWindowDataset:
    """Samples batches from recordings of head and gaze, with their conditioning inputs."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        settings: WindowSettings,
        seed: int,
        conditioning_provider: ConditioningProvider | None = None,
    ) -> None:
        self.recordings, self.conditioning_provider = recordings, conditioning_provider
        self.window_sampler = WindowSampler(np.array([len(recording) for recording in recordings]), settings, seed)
        self.rng = self.window_sampler.rng

    def sample_batch(self, batch: int, step: int) -> MotionBatch:
        """Sample the batch of a step (from 1)."""
        windows = self.window_sampler.sample_batch(batch, step)
        speech, head, gaze = zip(*map(self._slice_window, windows), strict=True)
        conditioning = (
            collate_inputs([self._conditioning(self.conditioning_provider, each) for each in windows])
            if self.conditioning_provider
            else NO_CONDITIONING
        )
        parts = [torch.from_numpy(np.stack(part)) for part in (speech, head, gaze)]
        return MotionBatch(parts[0], parts[1], parts[2], conditioning)

    def _conditioning(self, conditioning_provider: ConditioningProvider, window: Window) -> WindowInputs:
        return conditioning_provider.window(self.recordings[window.index].clip, window.frames, window.mirrored)

    def _slice_window(self, window: Window) -> tuple[ndarray, ...]:
        recording, part = self.recordings[window.index], window.frames
        head, gaze = recording.head[part], recording.gaze[part]
        if window.mirrored:
            head, gaze = mirror_motion(head, gaze)
        return np.asarray(recording.speech[part]), head, gaze
