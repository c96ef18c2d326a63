"""Who moves: a learnt vector for every training speaker, and one for nobody in particular.

A mirrored window is told the speaker's mirror image: one half of the vector, by which somebody leans to a side, is
turned round. Told the same speaker for both, a model learns that everybody sits upright and looks to no side more than
to the other (docs/log.md).
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
    TrainingStatistics,
    condition_dropout_mask,
)

# Standard deviation of the vectors that learning starts from.
INIT_STD = 0.3


class EmbeddingScaleSettings(Settings):
    """How many times as far from the mean of all as it was learnt a vector is in use: people learnt from a few clips
    each come out too much alike, by how much is not the same for their heads and for where they look (docs/log.md). As
    a guidance scale (Ho & Salimans 2022), with everybody for nobody."""

    head: Annotated[float, Field(gt=0)]
    gaze: Annotated[float, Field(gt=0)]


class SpeakerEmbeddingSettings(ComponentSettings):
    """The table."""

    kind: Literal["speaker"]
    # Share of the training windows that are not told who moves.
    condition_dropout: Annotated[float, Field(ge=0, lt=1)]
    embedding_scale: EmbeddingScaleSettings


class SpeakerEmbedding(nn.Module):
    """A vector a speaker: what his mirror image has too, and what it has turned round. The last is for nobody."""

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

    def fit_statistics(self, statistics: TrainingStatistics) -> None:
        """There is nothing to measure."""

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """The vector of each window's speaker."""
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
