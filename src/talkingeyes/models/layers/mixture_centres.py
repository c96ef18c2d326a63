"""Centres of the absolute mixture components of a point process: learned, k-means or VQ-VAE.

`learned` centres are trained by the likelihood with all other parameters. The other kinds are codebooks like that of
gaze in the paper (eq. 5 to 7; quantiser.py), learned from the locations of true events without gradient from the
likelihood. `k_means` clusters locations online. `vq_vae` clusters latents of locations, and its centres are the decoded
codes.
"""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.models.layers.quantiser import Quantiser, QuantiserSettings

MixtureCentresKind = Literal["learned", "k_means", "vq_vae"]
LATENT, HIDDEN = 8, 32


class LearnedCentres(nn.Module):
    """Trainable parameters."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        self.locations = nn.Parameter(start)

    def forward(self) -> Float[Tensor, "M D"]:
        """The centres."""
        return self.locations

    def auxiliary_loss(self, locations: Float[Tensor, "K D"]) -> dict[str, Tensor]:
        """Loss terms of the centres from the locations of true events (training)."""
        return {}


class KMeansCentres(nn.Module):
    """Centres of clusters of locations."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        self.quantiser = Quantiser(_settings(*start.shape))

    def forward(self) -> Float[Tensor, "M D"]:
        """The centres."""
        return self.quantiser.codebook

    def auxiliary_loss(self, locations: Float[Tensor, "K D"]) -> dict[str, Tensor]:
        """Update the centres from the locations; there is no loss term."""
        self.quantiser(locations[None])
        return {}


class VQVAECentres(nn.Module):
    """Decoded codes of a VQ-VAE of locations."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        count, numbers = start.shape
        self.encoder = nn.Sequential(nn.Linear(numbers, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, LATENT))
        self.quantiser = Quantiser(_settings(count, LATENT))
        self.decoder = nn.Sequential(nn.Linear(LATENT, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, numbers))

    def forward(self) -> Float[Tensor, "M D"]:
        """The decoded codes, without gradient from the likelihood of events."""
        with torch.no_grad():
            out: Tensor = self.decoder(self.quantiser.codebook)
        return out

    def auxiliary_loss(self, locations: Float[Tensor, "K D"]) -> dict[str, Tensor]:
        """Reconstruction and commitment (eq. 7)."""
        quantised = self.quantiser(self.encoder(locations)[None])
        error = (self.decoder(quantised.values[0]) - locations).square().mean()
        return {"mixture_centres": error + self.quantiser.settings.commitment * quantised.commitment}


def _settings(codes: int, width: int) -> QuantiserSettings:
    return QuantiserSettings(kind="codebook", codes=codes, width=width, commitment=0.25, decay=0.98, restart_below=0.05)


MIXTURE_CENTRES: dict[MixtureCentresKind, type[LearnedCentres] | type[KMeansCentres] | type[VQVAECentres]] = {
    "learned": LearnedCentres,
    "k_means": KMeansCentres,
    "vq_vae": VQVAECentres,
}
