"""Random windows of fitted faces as training batches, and the statistics that normalise faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from talkingeyes.corpus.faces import FaceRecording
from talkingeyes.models.face.basis import JAW_DIM, FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.speech_to_face import FaceBatch
from talkingeyes.training.windows import Window, motion_statistics


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


def face_batch(basis: FaceBasis, vocabulary: StyleVocabulary, windows: Sequence[Window[FaceRecording]]) -> FaceBatch:
    """Windows of faces with their speech and style."""
    rows = []
    for each in windows:
        recording, part = each.recording, each.frames
        face = basis.to_vector(recording.expression[part], recording.jaw[part])
        style = vocabulary.style_vector(vocabulary.style_of(recording.clip))
        rows.append((np.asarray(recording.speech[part]), style[None], basis.mirrored(face) if each.mirrored else face))
    return FaceBatch(*(torch.from_numpy(np.stack(part)) for part in zip(*rows, strict=True)))
