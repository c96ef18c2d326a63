"""Vector quantisation (TalkingEyes eq. 5 and 7; van den Oord et al. 2017).

The codebook term of eq. 7 is minimised by its closed form, an exponential moving average of the latents that chose a
code (van den Oord et al. 2017, appendix A.1): by gradient the codebook collapses to a few codes (docs/log.md). Codes
that are hardly used are restarted at latents of the batch (Dhariwal et al. 2020, Jukebox).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers import distributed


class QuantiserSettings(Settings):
    """A codebook."""

    kind: Literal["codebook"]
    # Number of codes N (the paper: 1,024).
    codes: Annotated[int, Field(gt=1)]
    # Width C of a code.
    width: Annotated[int, Field(gt=0)]
    # Weight beta of the commitment term in eq. 7.
    commitment: Annotated[float, Field(ge=0)]
    # Decay of the moving averages.
    decay: Annotated[float, Field(gt=0, lt=1)]
    # A code whose average count in a batch falls below this is restarted.
    restart_below: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class QuantiserOutput:
    """Codes of latents. `values` pass gradients straight through; `commitment` is the last term of eq. 7."""

    values: Float[Tensor, "*N C"]
    indices: Int[Tensor, "*N"]
    commitment: Float[Tensor, ""]


class Quantiser(nn.Module):
    """The codebook Z = {z_k}; updated in training mode only."""

    codebook: Tensor
    counts: Tensor
    sums: Tensor
    initialised: Tensor

    def __init__(self, settings: QuantiserSettings) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("codebook", torch.randn(settings.codes, settings.width))
        self.register_buffer("counts", torch.ones(settings.codes))
        self.register_buffer("sums", self.codebook.clone())
        self.register_buffer("initialised", torch.tensor(False))

    def distances(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N K"]:
        """Squared distances to every code."""
        return squared_distances(latents, self.codebook)

    def to_code_space(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N C"]:
        """Latents and codes are of one space."""
        return latents

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Nearest codes (eq. 5). Only latents where `mask` count for the losses and the codebook."""
        latents = latents.float()  # under autocast too: codes are compared in full precision
        with torch.autocast(latents.device.type, enabled=False):
            if self.training:
                kept = latents if mask is None else latents[mask]
                self.update(distributed.all_gather_rows(kept.detach().reshape(-1, latents.shape[-1])))
        return quantise(self, latents, mask)

    @torch.no_grad()
    def update(self, latents: Float[Tensor, "M C"]) -> None:
        """Move the averages of codes on by the latents of a batch."""
        if not len(latents):
            return
        if not self.initialised:
            self._restart(torch.ones_like(self.counts, dtype=torch.bool), latents)
            self.initialised.fill_(True)
        indices = self.distances(latents).argmin(-1)
        decay = self.settings.decay
        counts = torch.bincount(indices, minlength=len(self.counts)).to(latents.dtype)
        sums = torch.zeros_like(self.sums).index_add_(0, indices, latents)
        self.counts.mul_(decay).add_(counts, alpha=1 - decay)
        self.sums.mul_(decay).add_(sums, alpha=1 - decay)
        self.codebook.copy_(self.sums / self.counts.clamp(min=1e-6)[:, None])
        self._restart(self.counts < self.settings.restart_below, latents)

    def _restart(self, dead: Bool[Tensor, " K"], latents: Float[Tensor, "M C"]) -> None:
        """Put codes on latents of this batch, a little apart so that several on one latent can part."""
        count = int(dead.sum())
        if not count:
            return
        chosen = latents[torch.randint(len(latents), (count,))]
        chosen = chosen + 0.01 * latents.std() * torch.randn_like(chosen)
        self.codebook[dead] = chosen
        self.sums[dead] = chosen
        self.counts[dead] = 1.0


@runtime_checkable
class Codebook(Protocol):
    """What latents are compared with."""

    @property
    def codebook(self) -> Float[Tensor, "K C"]: ...

    def distances(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N K"]: ...


def quantise(codes: Codebook, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None) -> QuantiserOutput:
    """Nearest codes (eq. 5), straight through, and how far from them the latents where `mask` lie (eq. 7)."""
    latents = latents.float()
    with torch.autocast(latents.device.type, enabled=False):
        indices = codes.distances(latents.detach()).argmin(-1)
    values = codes.codebook[indices]
    error = (latents - values).square().mean(-1)
    commitment = (
        error.mean()
        if mask is None
        else (error * mask).sum() / distributed.all_reduce_mean(mask.sum().float()).clamp(min=1)
    )
    return QuantiserOutput(latents + (values - latents).detach(), indices, commitment)


def squared_distances(latents: Float[Tensor, "*N C"], codebook: Float[Tensor, "K C"]) -> Float[Tensor, "*N K"]:
    """Squared distances to every code."""
    squares = latents.square().sum(-1, keepdim=True) + codebook.square().sum(-1)
    return squares - 2 * latents @ codebook.T


def perplexity(counts: Float[Tensor, " K"]) -> float:
    """exp of the entropy of code use; depends on how much data was counted, so give it with the codes used."""
    shares = counts / counts.sum().clamp(min=1)
    return float(torch.exp(-(shares * shares.clamp(min=1e-12).log()).sum()))
