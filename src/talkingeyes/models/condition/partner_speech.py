"""What the partner says: the embedding of the second channel of a conversation, so that a listener moves too."""

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
    """How the partner is heard: a SpeechSettings as wide as that of one's own speech."""

    kind: Literal["partner"]
    channels: tuple[str, ...] | None
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    channel_dropout: Annotated[float, Field(ge=0, lt=1)]


class PartnerSpeech(nn.Module):
    """Features of the partner's speech, as wide as one's own; zero where there is no partner."""

    settings_class = PartnerSpeechSettings
    required_inputs: tuple[InputName, ...] = ("partner",)

    def __init__(self, settings: PartnerSpeechSettings, width: int, spec: ConditioningSpec) -> None:
        super().__init__()
        own = SpeechProjectionSettings(width=width, **settings.model_dump(exclude={"kind"}))
        self.speech = SpeechProjection(own, spec.channels)

    def fit_statistics(self, statistics: TrainingStatistics) -> None:
        """Both channels are heard in the same units."""
        self.speech.standardise_by(statistics.mean, statistics.std)

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """A row a frame."""
        if conditioning.partner is None:
            return ConditionFeatures.shared(
                self.speech.mean.new_zeros(batch_size, 1, self.speech.stack.input_projection.out_features)
            )
        missing = conditioning.partner.isnan().flatten(1).any(1)
        partner_features: Tensor = self.speech(conditioning.partner.nan_to_num())
        return ConditionFeatures.shared(torch.where(missing[:, None, None], 0.0, partner_features))
