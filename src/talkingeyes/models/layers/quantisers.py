"""The kinds of quantiser, told apart by `kind`; all have a `codebook` of values, `distances` to it, and indices."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from talkingeyes.models.layers.finite_scalar import FiniteScalarQuantiser, FiniteScalarSettings
from talkingeyes.models.layers.quantiser import Quantiser, QuantiserSettings
from talkingeyes.models.layers.residual import ResidualQuantiser, ResidualSettings

AnyQuantiser = Quantiser | FiniteScalarQuantiser | ResidualQuantiser
AnyQuantiserSettings = Annotated[
    QuantiserSettings | FiniteScalarSettings | ResidualSettings, Field(discriminator="kind")
]


def make_quantiser(settings: QuantiserSettings | FiniteScalarSettings | ResidualSettings) -> AnyQuantiser:
    """The quantiser that a section configures."""
    if isinstance(settings, FiniteScalarSettings):
        return FiniteScalarQuantiser(settings)
    if isinstance(settings, ResidualSettings):
        return ResidualQuantiser(settings)
    return Quantiser(settings)
