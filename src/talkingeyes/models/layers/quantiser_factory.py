"""The quantisers by `kind`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from talkingeyes.models.layers.elementwise import ElementwiseQuantiser, ElementwiseQuantiserSettings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser, GradientQuantiserSettings
from talkingeyes.models.layers.quantiser import Codebook, Quantiser, QuantiserSettings

AnyQuantiserSettings = Annotated[
    QuantiserSettings | GradientQuantiserSettings | ElementwiseQuantiserSettings, Field(discriminator="kind")
]


def make_quantiser(settings: AnyQuantiserSettings) -> Codebook:
    """Build the quantiser that the settings describe."""
    if isinstance(settings, ElementwiseQuantiserSettings):
        return ElementwiseQuantiser(settings)
    if isinstance(settings, GradientQuantiserSettings):
        return GradientQuantiser(settings)
    return Quantiser(settings)
