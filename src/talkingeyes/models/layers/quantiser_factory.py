"""The quantisers by `kind`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from talkingeyes.models.layers.elementwise import ElementwiseQuantiser, ElementwiseQuantiserSettings
from talkingeyes.models.layers.finite_scalar import FiniteScalarQuantiser, FiniteScalarQuantiserSettings
from talkingeyes.models.layers.gradient_quantiser import GradientQuantiser, GradientQuantiserSettings
from talkingeyes.models.layers.quantiser import Codebook, Quantiser, QuantiserSettings
from talkingeyes.models.layers.residual import ResidualQuantiser, ResidualQuantiserSettings

AnyQuantiserSettings = Annotated[
    QuantiserSettings
    | GradientQuantiserSettings
    | ElementwiseQuantiserSettings
    | FiniteScalarQuantiserSettings
    | ResidualQuantiserSettings,
    Field(discriminator="kind"),
]


def make_quantiser(settings: AnyQuantiserSettings) -> Codebook:
    """Build the quantiser that the settings describe."""
    if isinstance(settings, ElementwiseQuantiserSettings):
        return ElementwiseQuantiser(settings)
    if isinstance(settings, FiniteScalarQuantiserSettings):
        return FiniteScalarQuantiser(settings)
    if isinstance(settings, ResidualQuantiserSettings):
        return ResidualQuantiser(settings)
    if isinstance(settings, GradientQuantiserSettings):
        return GradientQuantiser(settings)
    return Quantiser(settings)
