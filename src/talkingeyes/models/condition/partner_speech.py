"""Conditioning on the partner's speech, the second channel of a conversation, so that listeners move too."""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.condition.conditioner import (
    ConditionFeatures,
    ConditioningInputs,
    ConditioningSpec,
    InputName,
    TrainingStatistics,
)
from talkingeyes.models.speech_projection import SpeechProjection, SpeechProjectionSettings


class PartnerSpeechSettings(ComponentSettings):
    """Settings of the projection of the partner's speech, whose width is that of the own speech."""

    kind: Literal["partner"]
    channels: tuple[str, ...] | None
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    channel_dropout: Annotated[float, Field(ge=0, lt=1)]


class PartnerSpeech(nn.Module):
    """Projected features of the partner's speech; zero without a partner."""

    settings_class = PartnerSpeechSettings
    required_inputs: tuple[InputName, ...] = ("partner",)

    def __init__(self, settings: PartnerSpeechSettings, width: int, spec: ConditioningSpec) -> None:
        super().__init__()
        own = SpeechProjectionSettings(width=width, **settings.model_dump(exclude={"kind"}))
        self.speech = SpeechProjection(own, spec.channels)

    def fit_statistics(self, statistics: TrainingStatistics) -> None:
        """Standardise the partner's channel with the statistics of the own channel."""
        self.speech.standardise_by(statistics.mean, statistics.std)

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """One vector per frame."""
        if conditioning.partner is None:
            return ConditionFeatures.shared(
                self.speech.mean.new_zeros(batch_size, 1, self.speech.stack.input_projection.out_features)
            )
        missing = conditioning.partner.isnan().flatten(1).any(1)
        partner_features: Tensor = self.speech(conditioning.partner.nan_to_num())
        return ConditionFeatures.shared(torch.where(missing[:, None, None], 0.0, partner_features))
