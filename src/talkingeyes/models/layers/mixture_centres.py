"""Centres of the absolute mixture components of a point process: learned, k-means or VQ-VAE.

`learned` moves them by the gradient of the likelihood, with all the rest. The others are codebooks as the gaze of the
paper has one (eq. 5 to 7; quantiser.py), learnt from the places that true events lead to, which the likelihood does not
move: `k_means` is clustered online; `vq_vae` clusters latents of places, and stands where its decoder puts its codes.
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
    """Parameters like any other."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        self.locations = nn.Parameter(start)

    def forward(self) -> Float[Tensor, "M D"]:
        """The places."""
        return self.locations

    def auxiliary_loss(self, locations: Float[Tensor, "K D"]) -> dict[str, Tensor]:
        """In training, from the places of true events: terms of the loss of its own."""
        return {}


class KMeansCentres(nn.Module):
    """Centres of clusters."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        self.quantiser = Quantiser(_settings(*start.shape))

    def forward(self) -> Float[Tensor, "M D"]:
        """The centres."""
        return self.quantiser.codebook

    def auxiliary_loss(self, locations: Float[Tensor, "K D"]) -> dict[str, Tensor]:
        """Centres move to what is nearest to them; no term."""
        self.quantiser(locations[None])
        return {}


class VQVAECentres(nn.Module):
    """Codes of an autoencoder of places."""

    def __init__(self, start: Float[Tensor, "M D"]) -> None:
        super().__init__()
        count, numbers = start.shape
        self.encoder = nn.Sequential(nn.Linear(numbers, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, LATENT))
        self.quantiser = Quantiser(_settings(count, LATENT))
        self.decoder = nn.Sequential(nn.Linear(LATENT, HIDDEN), nn.GELU(), nn.Linear(HIDDEN, numbers))

    def forward(self) -> Float[Tensor, "M D"]:
        """What the codes are decoded to; the likelihood of events moves neither."""
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
