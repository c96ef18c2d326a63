"""Residual vector quantisation (RVQ): a code is a sum of one code per level, each level coding the residual.

Zeghidour et al. 2021 (SoundStream). D levels of K codes each give K^D sums: few vectors are learned, each from much
data, and similar gaze has similar codes. An index identifies a whole combination, so decoders that predict one code do
not need to know about levels. The nearest of all sums is chosen, which a greedy search level by level can miss.
"""

from __future__ import annotations

from typing import Annotated, Literal

from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from torch import Tensor, nn

from talkingeyes.core.settings import Settings, bounds_error
from talkingeyes.models.layers import distributed
from talkingeyes.models.layers.quantiser import (
    Codebook,
    Quantiser,
    QuantiserOutput,
    QuantiserSettings,
)

MAX_CODES = 4096


class ResidualQuantiserSettings(Settings):
    """Settings of the residual codebooks."""

    kind: Literal["residual"]
    # Number of levels.
    depth: Annotated[int, Field(gt=1)]
    # Codes per level.
    level_codes: Annotated[int, Field(gt=1)]
    width: Annotated[int, Field(gt=0)]
    # Weight beta of the commitment term in eq. 7.
    commitment: Annotated[float, Field(ge=0)]
    decay: Annotated[float, Field(gt=0, lt=1)]
    restart_below: Annotated[float, Field(ge=0)]

    @model_validator(mode="after")
    def _can_be_listed(self) -> ResidualQuantiserSettings:
        if self.codes > MAX_CODES:
            raise bounds_error(f"level_codes to the power of depth should be at most {MAX_CODES}", self.codes)
        return self

    @property
    def codes(self) -> int:
        """Number of sums."""
        number: int = self.level_codes**self.depth
        return number

    @property
    def level(self) -> QuantiserSettings:
        """Settings of one level."""
        shared = {name: getattr(self, name) for name in ("width", "commitment", "decay", "restart_below")}
        return QuantiserSettings(kind="codebook", codes=self.level_codes, **shared)


class ResidualQuantiser(Codebook):
    """A sequence of codebooks, updated in training mode only."""

    def __init__(self, settings: ResidualQuantiserSettings) -> None:
        super().__init__()
        self.settings = settings
        self.levels = nn.ModuleList(Quantiser(settings.level) for _ in range(settings.depth))

    @property
    def _level_list(self) -> list[Quantiser]:
        return [level for level in self.levels if isinstance(level, Quantiser)]

    @property
    def codebook(self) -> Float[Tensor, "K C"]:  # type: ignore[override]  # computed from the levels
        """All sums; the index of the last level varies fastest."""
        table, *others = (level.codebook for level in self._level_list)
        for each in others:
            table = (table[:, None] + each).flatten(0, 1)
        return table

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Nearest sums. Only latents where `mask` is true count for the losses and the codebooks."""
        if self.training:
            kept = latents.float() if mask is None else latents.float()[mask]
            rest = distributed.all_gather_rows(kept.detach().reshape(-1, latents.shape[-1]))
            for level in self._level_list:
                level.update(rest)
                rest = rest - level.codebook[level.distances(rest).argmin(-1)]
        return self.quantise(latents, mask)
