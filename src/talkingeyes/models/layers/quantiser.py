"""Vector quantisation (TalkingEyes eq. 5 and 7; van den Oord et al. 2017).

The codebook term of eq. 7 is minimised in closed form, by an exponential moving average of the latents assigned to each
code (van den Oord et al. 2017, appendix A.1). `gradient_quantiser` minimises it by gradient, as printed. Rarely used
codes are restarted at latents of the batch (Dhariwal et al. 2020, Jukebox).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers import distributed


class QuantiserSettings(Settings):
    """Settings of a codebook."""

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
    """Codes of latents. `values` are `codes` with a straight-through gradient; `commitment` is the last term of eq. 7,
    and `codebook_error` the one before it: 0 for codes that are not learned by gradient."""

    values: Float[Tensor, "*N C"]
    codes: Float[Tensor, "*N C"]
    indices: Int[Tensor, "*M"]  # N, and of an element-wise quantiser a last axis of factors
    commitment: Float[Tensor, ""]
    codebook_error: Float[Tensor, ""]


class Codebook(nn.Module):
    """K codes of C numbers, and the nearest codes of latents. A subclass sets `codebook` and implements `forward`."""

    codebook: Tensor

    def distances(self, latents: Float[Tensor, "*N C"]) -> Float[Tensor, "*N K"]:
        """Squared distances to all codes."""
        return squared_distances(latents, self.codebook)

    def quantise(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None) -> QuantiserOutput:
        """Nearest codes (eq. 5), straight through, and the commitment loss of latents where `mask` is true (eq. 7)."""
        latents = latents.float()
        with torch.autocast(latents.device.type, enabled=False):
            indices = self.distances(latents.detach()).argmin(-1)
        values = self.codebook[indices]
        commitment = mean_error(latents, values.detach(), mask)
        straight_through, zero = latents + (values - latents).detach(), latents.new_zeros(())
        return QuantiserOutput(straight_through, values.detach(), indices, commitment, zero)


class Quantiser(Codebook):
    """The codebook Z = {z_k}, updated in training mode only."""

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

    def forward(self, latents: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None = None) -> QuantiserOutput:
        """Nearest codes (eq. 5). Only latents where `mask` is true count for the losses and the codebook."""
        latents = latents.float()  # distances in full precision, also under autocast
        with torch.autocast(latents.device.type, enabled=False):
            if self.training:
                kept = latents if mask is None else latents[mask]
                self.update(distributed.all_gather_rows(kept.detach().reshape(-1, latents.shape[-1])))
        return self.quantise(latents, mask)

    @torch.no_grad()
    def update(self, latents: Float[Tensor, "M C"]) -> None:
        """Update the moving averages by the latents of a batch."""
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
        """Move codes to latents of this batch, with a little noise so that codes at the same latent can separate."""
        count = int(dead.sum())
        if not count:
            return
        chosen = latents[torch.randint(len(latents), (count,))]
        chosen = chosen + 0.01 * latents.std() * torch.randn_like(chosen)
        self.codebook[dead] = chosen
        self.sums[dead] = chosen
        self.counts[dead] = 1.0


def mean_error(
    latents: Float[Tensor, "B N C"], values: Float[Tensor, "B N C"], mask: Bool[Tensor, "B N"] | None
) -> Float[Tensor, ""]:
    """Mean squared difference of latents and codes, over the latents where `mask` is true."""
    error = (latents - values).square().mean(-1)
    if mask is None:
        return error.mean()
    return (error * mask).sum() / distributed.all_reduce_mean(mask.sum().float()).clamp(min=1)


def squared_distances(latents: Float[Tensor, "*N C"], codebook: Float[Tensor, "K C"]) -> Float[Tensor, "*N K"]:
    """Squared distances to all codes."""
    squares = latents.square().sum(-1, keepdim=True) + codebook.square().sum(-1)
    return squares - 2 * latents @ codebook.T


def code_figures(counts: Float[Tensor, " K"]) -> dict[str, float]:
    """Number and fraction of used codes, and perplexity."""
    used = int((counts > 0).sum())
    return {
        "codes_used": float(used),
        "codes_used_fraction": used / len(counts),
        "perplexity": perplexity(counts),
    }


def perplexity(counts: Float[Tensor, " K"]) -> float:
    """exp of the entropy of code use. It depends on the number of counted codes, so report it with the number of used
    codes."""
    shares = counts / counts.sum().clamp(min=1)
    return float(torch.exp(-(shares * shares.clamp(min=1e-12).log()).sum()))
