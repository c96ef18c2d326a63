"""What the partner says: the embedding of the second channel of a conversation, so that a listener moves too."""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models.condition.conditioner import Given, Known, Need, Seen, Told
from talkingeyes.models.speech import SpeechInput, SpeechSettings


class PartnerSpeechSettings(PartSettings):
    """How the partner is heard: a SpeechSettings as wide as that of one's own speech."""

    kind: Literal["partner"]
    channels: tuple[str, ...] | None
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    channel_dropout: Annotated[float, Field(ge=0, lt=1)]


class PartnerSpeech(nn.Module):
    """Features of the partner's speech, as wide as one's own; zero where there is no partner."""

    configured_by = PartnerSpeechSettings
    needs: tuple[Need, ...] = ("partner",)

    def __init__(self, settings: PartnerSpeechSettings, width: int, known: Known) -> None:
        super().__init__()
        own = SpeechSettings(width=width, **settings.model_dump(exclude={"kind"}))
        self.speech = SpeechInput(own, known.channels)

    def learn_from(self, seen: Seen) -> None:
        """Both channels are heard in the same units."""
        self.speech.standardise_by(seen.mean, seen.std)

    def forward(self, given: Given, rows: int) -> Told:
        """A row a frame."""
        if given.partner is None:
            return Told.alike(self.speech.mean.new_zeros(rows, 1, self.speech.stack.enter.out_features))
        missing = given.partner.isnan().flatten(1).any(1)
        heard: Tensor = self.speech(given.partner.nan_to_num())
        return Told.alike(torch.where(missing[:, None, None], 0.0, heard))
