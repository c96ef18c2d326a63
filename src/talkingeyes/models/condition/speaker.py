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

from talkingeyes.core.settings import PartSettings, Settings
from talkingeyes.models.condition.conditioner import Given, Known, Need, Seen, Told, told_nothing

# Standard deviation of the vectors that learning starts from.
START = 0.3


class EmphasisSettings(Settings):
    """How many times as far from the mean of all as it was learnt a vector is in use: people learnt from a few clips
    each come out too much alike, by how much is not the same for their heads and for where they look (docs/log.md). As
    a guidance scale (Ho & Salimans 2022), with everybody for nobody."""

    head: Annotated[float, Field(gt=0)]
    gaze: Annotated[float, Field(gt=0)]


class SpeakerTableSettings(PartSettings):
    """The table."""

    kind: Literal["speaker"]
    # Share of the training windows that are not told who moves.
    hidden: Annotated[float, Field(ge=0, lt=1)]
    emphasis: EmphasisSettings


class SpeakerTable(nn.Module):
    """A vector a speaker: what his mirror image has too, and what it has turned round. The last is for nobody."""

    configured_by = SpeakerTableSettings
    needs: tuple[Need, ...] = ("speaker",)

    def __init__(self, settings: SpeakerTableSettings, width: int, known: Known) -> None:
        super().__init__()
        self.hidden, self.emphasis, self.speakers = settings.hidden, settings.emphasis, len(known.speakers)
        self.upright, self.leaning = (nn.Embedding(self.speakers + 1, width) for _ in range(2))
        for table in (self.upright, self.leaning):
            nn.init.normal_(table.weight, std=START)

    def learn_from(self, seen: Seen) -> None:
        """There is nothing to measure."""

    def forward(self, given: Given, rows: int) -> Told:
        """The vector of each window's speaker."""
        device = self.upright.weight.device
        who = torch.full((rows,), -1, device=device) if given.speaker is None else given.speaker
        nobody = told_nothing(len(who), self.hidden, self.training, device) | (who < 0)
        side = torch.where(nobody, 0.0, torch.where(who < self.speakers, 1.0, -1.0))
        index = torch.where(nobody, self.speakers, who % self.speakers)
        found: Tensor = self.upright(index) + side[:, None] * self.leaning(index)
        if self.training:
            return Told.alike(found[:, None])
        everybody = torch.where(nobody[:, None], found, self.upright.weight[:-1].mean(0))
        own = found - everybody
        head, gaze = ((everybody + size * own)[:, None] for size in (self.emphasis.head, self.emphasis.gaze))
        return Told(head, gaze)
