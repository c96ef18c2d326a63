"""Conditioning on the emotion: a learned vector per emotion, times its strength. Neutral, as no emotion, is zero."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.condition.conditioner import (
    ConditionFeatures,
    ConditioningInputs,
    ConditioningSpec,
    InputName,
)
from talkingeyes.models.condition.emotion_strength import STRENGTH_EMOTIONS
from talkingeyes.models.condition.speaker_embedding import INIT_STD


class EmotionEmbeddingSettings(ComponentSettings):
    """Settings of the embedding: none."""

    kind: Literal["emotion"]


class EmotionEmbedding(nn.Module):
    """A vector per emotion. Emotions may change along a clip: strengths are those of a frame, or of all frames."""

    settings_class = EmotionEmbeddingSettings
    required_inputs: tuple[InputName, ...] = ("emotion",)

    def __init__(self, settings: EmotionEmbeddingSettings, width: int, spec: ConditioningSpec) -> None:
        super().__init__()
        self.emotions = nn.Linear(len(STRENGTH_EMOTIONS), width, bias=False)
        nn.init.normal_(self.emotions.weight, std=INIT_STD)

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """The vector of each window's emotion, in proportion to its strength."""
        strengths = conditioning.emotion
        if strengths is None:
            strengths = torch.zeros(batch_size, 1, len(STRENGTH_EMOTIONS), device=self.emotions.weight.device)
        vectors: Tensor = self.emotions(strengths)
        return ConditionFeatures.shared(vectors)
