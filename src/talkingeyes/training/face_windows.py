"""Random windows of fitted faces as training batches, and the statistics that normalise faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.models.face.basis import JAW_DIM, FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.speech_to_face import FaceBatch
from talkingeyes.training.windows import Window, WindowSampler, WindowSettings, motion_statistics


@dataclass(frozen=True)
class FaceStatistics:
    """Statistics of the faces of a split: mean, scale (one for expression, one for the jaw) and range."""

    mean: Float[Tensor, " F"]
    scale: Float[Tensor, " F"]
    min_face: Float[Tensor, " F"]
    max_face: Float[Tensor, " F"]

    @classmethod
    def of(cls, recordings: Sequence[FaceRecording]) -> FaceStatistics:
        """Statistics over all frames."""
        expression = np.concatenate([each.expression for each in recordings])
        jaw = np.concatenate([each.jaw for each in recordings])
        parts = [motion_statistics(expression), motion_statistics(jaw)]
        face = np.concatenate([expression, jaw], axis=1)
        scale = np.repeat([part.scale for part in parts], [expression.shape[1], JAW_DIM])
        arrays = (np.concatenate([part.mean for part in parts]), scale, face.min(0), face.max(0))
        return cls(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))


class FaceWindowDataset:
    """Samples batches of faces with their speech and style."""

    def __init__(
        self,
        recordings: Sequence[FaceRecording],
        basis: FaceBasis,
        vocabulary: StyleVocabulary,
        settings: WindowSettings,
        seed: int,
    ) -> None:
        self.recordings, self.basis, self.vocabulary = recordings, basis, vocabulary
        self.window_sampler = WindowSampler(np.array([len(recording) for recording in recordings]), settings, seed)
        self.rng = self.window_sampler.rng

    def sample_batch(self, batch: int, step: int) -> FaceBatch:
        """Sample the batch of a step (from 1)."""
        windows = self.window_sampler.sample_batch(batch, step)
        speech, style, face = zip(*map(self._slice_window, windows), strict=True)
        return FaceBatch(*(torch.from_numpy(np.stack(part)) for part in (speech, style, face)))

    def _slice_window(self, window: Window) -> tuple[ndarray, ...]:
        recording, part = self.recordings[window.index], window.frames
        face = self.basis.to_vector(recording.expression[part], recording.jaw[part])
        if window.mirrored:
            face = self.basis.mirrored(face)
        style = self.vocabulary.style_vector(self.vocabulary.style_of(recording.clip))
        return np.asarray(recording.speech[part]), style[None], face
