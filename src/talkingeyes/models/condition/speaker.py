"""Who moves: a learnt vector for every training speaker, and one for nobody in particular."""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.models.condition.conditioner import Given, Known, Need, Seen, told_nothing
from talkingeyes.settings import PartSettings


class SpeakerTableSettings(PartSettings):
    """The table."""

    kind: Literal["speaker"]
    # Share of the training windows that are not told who moves.
    hidden: Annotated[float, Field(ge=0, lt=1)]


class SpeakerTable(nn.Module):
    """A vector a speaker; the last one is for whoever is not known."""

    configured_by = SpeakerTableSettings
    needs: tuple[Need, ...] = ("speaker",)

    def __init__(self, settings: SpeakerTableSettings, width: int, known: Known) -> None:
        super().__init__()
        self.hidden, self.nobody = settings.hidden, len(known.speakers)
        self.vectors = nn.Embedding(self.nobody + 1, width)

    def learn_from(self, seen: Seen) -> None:
        """There is nothing to measure."""

    def forward(self, given: Given, rows: int) -> Float[Tensor, "B 1 S"]:
        """The vector of each window's speaker."""
        device = self.vectors.weight.device
        who = torch.full((rows,), -1, device=device) if given.speaker is None else given.speaker
        hidden = told_nothing(len(who), self.hidden, self.training, device) | (who < 0)
        found: Tensor = self.vectors(torch.where(hidden, self.nobody, who))
        return found[:, None]
