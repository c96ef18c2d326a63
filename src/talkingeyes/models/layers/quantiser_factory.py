"""The quantisers by `kind`. Each has a `codebook`, `distances` to it, and returns code indices."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from talkingeyes.models.layers.finite_scalar import FiniteScalarQuantiser, FiniteScalarQuantiserSettings
from talkingeyes.models.layers.quantiser import Quantiser, QuantiserSettings
from talkingeyes.models.layers.residual import ResidualQuantiser, ResidualQuantiserSettings

AnyQuantiser = Quantiser | FiniteScalarQuantiser | ResidualQuantiser
AnyQuantiserSettings = Annotated[
    QuantiserSettings | FiniteScalarQuantiserSettings | ResidualQuantiserSettings, Field(discriminator="kind")
]


def make_quantiser(
    settings: QuantiserSettings | FiniteScalarQuantiserSettings | ResidualQuantiserSettings,
) -> AnyQuantiser:
    """Build the quantiser that the settings describe."""
    if isinstance(settings, FiniteScalarQuantiserSettings):
        return FiniteScalarQuantiser(settings)
    if isinstance(settings, ResidualQuantiserSettings):
        return ResidualQuantiser(settings)
    return Quantiser(settings)
