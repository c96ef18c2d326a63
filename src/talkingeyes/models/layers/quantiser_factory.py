"""The kinds of quantiser, told apart by `kind`; all have a `codebook` of values, `distances` to it, and indices."""

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
    """The quantiser that a section configures."""
    if isinstance(settings, FiniteScalarQuantiserSettings):
        return FiniteScalarQuantiser(settings)
    if isinstance(settings, ResidualQuantiserSettings):
        return ResidualQuantiser(settings)
    return Quantiser(settings)
