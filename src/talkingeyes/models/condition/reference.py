"""How somebody moves: a style read off a clip of motion, so that speakers whom the training never saw have one too.

In training the clip is another one of the window's own speaker: what both share is the person, not what is said. The
paper names a speaker embedding as what its model lacks (section VI). What is read are statistics, few enough that a
dozen speakers do not let the encoder learn them by heart.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models.condition.conditioner import Given, Known, Need, Seen, Told, told_nothing

MOTION = 9
DESCRIBED = 3 * MOTION
FARTHEST = 3.0  # deviations: nobody's style is read as stranger than that
SMALLEST = 1e-4  # radians: what moves less is still


class ReferenceStyleSettings(PartSettings):
    """The encoder of styles."""

    kind: Literal["reference"]
    # Numbers of a style.
    numbers: Annotated[int, Field(gt=0)]
    # Share of the training windows that are given no reference.
    hidden: Annotated[float, Field(ge=0, lt=1)]


class ReferenceStyle(nn.Module):
    """A vector of each reference, or a learnt one where there is none."""

    mean: Tensor
    std: Tensor

    configured_by = ReferenceStyleSettings
    needs: tuple[Need, ...] = ("reference",)

    def __init__(self, settings: ReferenceStyleSettings, width: int, known: Known) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("mean", torch.zeros(DESCRIBED))
        self.register_buffer("std", torch.ones(DESCRIBED))
        self.style = nn.Linear(DESCRIBED, settings.numbers)
        self.vector = nn.Linear(settings.numbers, width)
        self.nobody = nn.Parameter(torch.zeros(width))

    def learn_from(self, seen: Seen) -> None:
        """In what, and by how much, the motions of the train split differ."""
        described = torch.stack([described_motion(each[None])[0] for each in seen.motions])
        std = described.std(0, correction=0)
        self.mean.copy_(described.mean(0))
        self.std.copy_(torch.where(std > SMALLEST, std, torch.inf))

    def forward(self, given: Given, rows: int) -> Told:
        """The vector of each window's reference."""
        if given.reference is None:
            return Told.alike(self.nobody.expand(rows, 1, -1))
        missing = given.reference.isnan().flatten(1).any(1)
        described = (described_motion(given.reference.nan_to_num()) - self.mean) / self.std
        described = described.clamp(-FARTHEST, FARTHEST)
        found = self.vector(self.style(described).tanh())
        hidden = missing | told_nothing(len(missing), self.settings.hidden, self.training, missing.device)
        return Told.alike(torch.where(hidden[:, None], self.nobody, found)[:, None])


def described_motion(motion: Float[Tensor, "B R 9"]) -> Float[Tensor, "B 27"]:
    """Where each number rests, and the logarithms of how far and how fast it moves."""
    wide = motion.std(1, correction=0).clamp(min=SMALLEST).log()
    fast = motion.diff(dim=1).abs().mean(1).clamp(min=SMALLEST / 10).log()
    return torch.cat([motion.mean(1), wide, fast], dim=1)
