"""Conditioning on the speaker: a learned vector per training speaker and one for unconditional windows.

A mirrored window uses the mirror image of its speaker: the antisymmetric half of the vector, which encodes a lean to
one side, changes its sign. If both windows used the same vector, the model would learn that all speakers sit upright
and look equally to both sides (docs/log.md).
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings, Settings
from talkingeyes.models.condition.conditioner import (
    ConditionFeatures,
    ConditioningInputs,
    ConditioningSpec,
    InputName,
    condition_dropout_mask,
)

# Standard deviation of the initial vectors.
INIT_STD = 0.3


class EmbeddingScaleSettings(Settings):
    """Factors on the deviation of a vector from the mean vector at inference. Speakers with few training clips come out
    too similar, to a different degree for head and gaze (docs/log.md). Comparable to a guidance scale (Ho & Salimans
    2022), with the mean speaker as the unconditional model."""

    head: Annotated[float, Field(gt=0)]
    gaze: Annotated[float, Field(gt=0)]


class SpeakerEmbeddingSettings(ComponentSettings):
    """Settings of the embedding."""

    kind: Literal["speaker"]
    # Fraction of the training windows that are unconditional.
    condition_dropout: Annotated[float, Field(ge=0, lt=1)]
    embedding_scale: EmbeddingScaleSettings


class SpeakerEmbedding(nn.Module):
    """A vector per speaker: a symmetric part, shared by the mirror image, plus or minus an antisymmetric part. The last
    vector is the unconditional one."""

    settings_class = SpeakerEmbeddingSettings
    required_inputs: tuple[InputName, ...] = ("speaker",)

    def __init__(self, settings: SpeakerEmbeddingSettings, width: int, spec: ConditioningSpec) -> None:
        super().__init__()
        self.condition_dropout, self.embedding_scale, self.speakers = (
            settings.condition_dropout,
            settings.embedding_scale,
            len(spec.speakers),
        )
        self.symmetric, self.antisymmetric = (nn.Embedding(self.speakers + 1, width) for _ in range(2))
        for table in (self.symmetric, self.antisymmetric):
            nn.init.normal_(table.weight, std=INIT_STD)

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """The vector of each window's speaker, scaled at inference."""
        device = self.symmetric.weight.device
        speaker_index = (
            torch.full((batch_size,), -1, device=device) if conditioning.speaker is None else conditioning.speaker
        )
        unconditional = condition_dropout_mask(len(speaker_index), self.condition_dropout, self.training, device) | (
            speaker_index < 0
        )
        side = torch.where(unconditional, 0.0, torch.where(speaker_index < self.speakers, 1.0, -1.0))
        index = torch.where(unconditional, self.speakers, speaker_index % self.speakers)
        found: Tensor = self.symmetric(index) + side[:, None] * self.antisymmetric(index)
        if self.training:
            return ConditionFeatures.shared(found[:, None])
        mean_embedding = torch.where(unconditional[:, None], found, self.symmetric.weight[:-1].mean(0))
        own = found - mean_embedding
        head, gaze = (
            (mean_embedding + size * own)[:, None] for size in (self.embedding_scale.head, self.embedding_scale.gaze)
        )
        return ConditionFeatures(head, gaze)
