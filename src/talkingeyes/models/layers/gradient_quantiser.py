"""Vector quantisation whose codebook is learned by gradient, as printed (TalkingEyes eq. 7, second term).

The codes start uniformly within +-1 / N, as in the code of van den Oord et al. (2017). Unused codes get no gradient and
stay where they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.quantiser import Codebook, QuantiserOutput, mean_error


class GradientQuantiserSettings(Settings):
    """Settings of a codebook that is learned by gradient."""

    kind: Literal["gradient_codebook"]
    # Number of codes N (the paper: 1,024).
    codes: Annotated[int, Field(gt=1)]
    # Width C of a code.
    width: Annotated[int, Field(gt=0)]
    # Weight beta of the commitment term in eq. 7.
    commitment: Annotated[float, Field(ge=0)]


class GradientQuantiser(Codebook):
    """The codebook Z = {z_k} as a parameter."""

    def __init__(self, settings: GradientQuantiserSettings) -> None:
        super().__init__()
        self.settings = settings
        self.codebook = nn.Parameter((2 * torch.rand(settings.codes, settings.width) - 1) / settings.codes)

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Nearest codes (eq. 5). Only latents where `mask` is true count for the losses."""
        found = self.quantise(latents, mask)
        return replace(found, codebook_error=mean_error(latents.detach().float(), self.codebook[found.indices], mask))
