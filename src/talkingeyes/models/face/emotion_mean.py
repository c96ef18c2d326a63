"""The constant mean face of each emotion: what a classifier of emotions is satisfied with, without any motion.

It bounds what `emotion accuracy` says (ProbTalk3D's Table 1): a face may show its emotion and not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.settings import Settings
from talkingeyes.models.face.style import EMOTIONS, FaceStyle


class EmotionMeanSettings(Settings):
    """Settings of the baseline: none."""

    kind: Literal["emotion_mean"]
    parts: tuple[Literal["face"], ...]
    tokenizer: None


@dataclass(frozen=True)
class EmotionMeans:
    """The mean over training frames of each of EMOTIONS; of all frames, for an emotion without any."""

    means: Float[ndarray, "E N"]

    @classmethod
    def of(cls, faces: Sequence[Float[ndarray, "T N"]], emotions: Sequence[str]) -> EmotionMeans:
        """Means of clips and their emotions, neutral where a clip has none."""
        own = {name: [face for face, each in zip(faces, emotions, strict=True) if each == name] for name in EMOTIONS}
        return cls(np.stack([np.concatenate(own[name] or faces).mean(axis=0) for name in EMOTIONS]).astype(np.float32))

    def face(self, style: FaceStyle) -> Float[ndarray, " N"]:
        """The mean face of the emotion of a style."""
        return np.asarray(self.means[EMOTIONS.index(style.emotion)])
