"""Element-wise quantisation (TalkingEyes eq. 5, after CodeTalker, Xing et al. 2023): a latent is split into factors.

Each factor is replaced by its nearest code of one shared codebook, so that N codes give N^F combinations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser, GradientQuantiserSettings
from talkingeyes.models.layers.quantiser import Codebook, Quantiser, QuantiserOutput, QuantiserSettings


class ElementwiseQuantiserSettings(Settings):
    """Settings of factors that share a codebook."""

    kind: Literal["elementwise"]
    # Number of factors F of a latent.
    factors: Annotated[int, Field(gt=0)]
    codebook: Annotated[QuantiserSettings | GradientQuantiserSettings, Field(discriminator="kind")]

    @property
    def width(self) -> int:
        """Width of a latent: all factors."""
        return self.factors * self.codebook.width

    @property
    def codes(self) -> int:
        """Number of codes of the codebook."""
        return self.codebook.codes

    @property
    def commitment(self) -> float:
        """Weight beta of the commitment term in eq. 7."""
        return self.codebook.commitment


class ElementwiseQuantiser(Codebook):
    """A codebook that quantises each factor of a latent; indices have a last axis of factors."""

    def __init__(self, settings: ElementwiseQuantiserSettings) -> None:
        super().__init__()
        self.settings = settings
        of_factor = settings.codebook
        self.factor: Codebook = (
            Quantiser(of_factor) if isinstance(of_factor, QuantiserSettings) else GradientQuantiser(of_factor)
        )

    @property
    def codebook(self) -> Float[Tensor, "K D"]:  # type: ignore[override]  # of the quantiser of a factor
        """The codes that all factors share."""
        return self.factor.codebook

    def distances(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N F K"]:
        """Squared distances of each factor to all codes."""
        return self.factor.distances(latents.unflatten(-1, (self.settings.factors, -1)))

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Nearest code of each factor. Only latents where `mask` is true count for the losses and the codebook."""
        factors = self.settings.factors
        split = latents.unflatten(-1, (factors, -1)).flatten(1, 2)
        found: QuantiserOutput = self.factor(split, None if mask is None else mask.repeat_interleave(factors, dim=1))
        return replace(
            found,
            values=found.values.unflatten(1, (-1, factors)).flatten(2),
            codes=found.codes.unflatten(1, (-1, factors)).flatten(2),
            indices=found.indices.unflatten(1, (-1, factors)),
        )
