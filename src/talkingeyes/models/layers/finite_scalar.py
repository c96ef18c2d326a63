"""Finite scalar quantisation: each latent dimension is rounded to one of a few levels (Mentzer et al. 2023).

The codes are all combinations of levels. There is no codebook to learn that could collapse, so neither commitment nor
restarts are needed. A latent is bounded by a tanh, then rounded with a straight-through gradient.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.quantiser import Codebook, QuantiserOutput

BOUND_MARGIN = 1e-3  # makes the outermost levels reachable by finite latents


class FiniteScalarQuantiserSettings(Settings):
    """Number of levels of each dimension. 8, 5, 5 and 5 levels give 1,000 codes."""

    kind: Literal["finite_scalar"]
    levels: Annotated[tuple[Annotated[int, Field(gt=1)], ...], Field(min_length=1)]

    @property
    def codes(self) -> int:
        """Number of codes."""
        return math.prod(self.levels)

    @property
    def width(self) -> int:
        """Dimensions of a code."""
        return len(self.levels)

    @property
    def commitment(self) -> float:
        """Zero: latents are bounded, so they cannot drift away from the codes."""
        return 0.0


class FiniteScalarQuantiser(Codebook):
    """Rounding to levels, without learned parameters."""

    reach: Tensor
    offset: Tensor
    steps: Tensor

    def __init__(self, settings: FiniteScalarQuantiserSettings) -> None:
        super().__init__()
        self.settings = settings
        levels = torch.tensor(settings.levels)
        self.register_buffer("reach", (levels // 2).float(), persistent=False)
        # With an even number of levels, there is one more level below 0 than above.
        self.register_buffer("offset", torch.where(levels % 2 == 0, 0.5, 0.0), persistent=False)
        steps = [math.prod(settings.levels[place + 1 :]) for place in range(len(levels))]
        self.register_buffer("steps", torch.tensor(steps), persistent=False)
        digits = torch.arange(settings.codes)[:, None] // self.steps % levels
        self.register_buffer("codebook", (digits - levels // 2) / (levels // 2), persistent=False)

    def to_code_space(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N C"]:
        """Bounded latents in the units of the codes, whose levels lie between -1 and 1."""
        bound = (self.reach - self.offset) * (1 + BOUND_MARGIN)
        shift = torch.atanh(self.offset / bound)
        return ((latents + shift).tanh() * bound - self.offset) / self.reach

    def distances(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N K"]:
        """Squared distances to all codes."""
        return (self.to_code_space(latents)[..., None, :] - self.codebook).square().sum(-1)

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Round to the nearest levels. `mask` has no effect, because nothing is learned here."""
        bounded = self.to_code_space(latents.float())
        rounded = (bounded.detach() * self.reach).round()
        indices: Int[Tensor, "B N"] = ((rounded + self.reach).long() * self.steps).sum(-1)
        values = self.codebook[indices]
        zero = latents.new_zeros(())
        return QuantiserOutput(bounded + (values - bounded).detach(), values, indices, zero, zero)
