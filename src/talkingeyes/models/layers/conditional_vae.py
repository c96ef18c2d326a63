"""Conditional VAE of a motion given a condition per frame (TalkingEyes eq. 8 and 13).

There is one latent code c per clip (`latent_frames: null`, as in the paper) or one every `latent_frames` frames. Codes
are interpolated at constant variance, so that a long motion has no seams. A code per clip is resampled every 20 s in
longer speech.

Free bits (Kingma et al. 2016, eq. 15) put a lower bound on the divergence of each dimension, so that emptying a
dimension completely does not reduce the loss (an extension of eq. 13).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models import losses
from talkingeyes.models.layers.convolution import ConvolutionStack

CLIP_LATENT_FRAMES = 500


class VAESettings(Settings):
    """Size of a conditional VAE."""

    width: Annotated[int, Field(gt=0)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Width of the latent code c.
    latent: Annotated[int, Field(gt=0)]
    # Frames per latent code; null: one code per clip.
    latent_frames: Annotated[int, Field(gt=0)] | None
    # Free bits of the divergence from the prior per latent dimension; 0: none.
    free_bits: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class DiagonalGaussian:
    """Mean and log-variance of the latent codes of a motion."""

    mean: Float[Tensor, "B N Z"]
    log_variance: Float[Tensor, "B N Z"]

    def rsample(self) -> Float[Tensor, "B N Z"]:
        """A reparameterised sample."""
        return self.mean + torch.randn_like(self.mean) * (0.5 * self.log_variance).exp()

    def divergence(self) -> Float[Tensor, ""]:
        """KL divergence from N(0, I) (eq. 13), mean over codes and dimensions."""
        return self.divergence_per_dim().mean()

    def divergence_per_dim(self) -> Float[Tensor, "B N Z"]:
        """KL divergence of each dimension from N(0, I), in nats."""
        return -0.5 * (1 + self.log_variance - self.log_variance.exp() - self.mean.square())


@dataclass(frozen=True)
class VAEReconstruction:
    """A motion decoded from a sample of its posterior, and its losses (eq. 11 to 13)."""

    motion: Float[Tensor, "B T F"]
    reconstruction: Float[Tensor, ""]
    velocity: Float[Tensor, ""]
    kl: Float[Tensor, ""]


class ConditionalVAE(nn.Module):
    """E_VAE and D_VAE of eq. 8 for a standardised motion of `features` numbers per frame."""

    def __init__(self, settings: VAESettings, features: int, condition: int) -> None:
        super().__init__()
        self.settings = settings
        self.encoder = ConvolutionStack(features + condition, settings.width, settings.layers, settings.dropout)
        self.moments = nn.Linear(settings.width, 2 * settings.latent)
        self.decoder = ConvolutionStack(settings.latent + condition, settings.width, settings.layers, settings.dropout)
        self.out = nn.Linear(settings.width, features)

    def latent_count(self, frames: int) -> int:
        """Number of latent codes of a motion of `frames` frames."""
        return max(1, math.ceil(frames / (self.settings.latent_frames or CLIP_LATENT_FRAMES)))

    def encode(self, motion: Float[Tensor, "B T F"], condition: Float[Tensor, "B T C"]) -> DiagonalGaussian:
        """Posterior of the codes; the moments of a code are means over its frames."""
        moments = self.moments(self.encoder(torch.cat([motion, condition], dim=-1))).float()
        span = self.settings.latent_frames or max(CLIP_LATENT_FRAMES, motion.shape[1])
        pooled = torch.stack([part.mean(1) for part in moments.split(span, dim=1)], dim=1)
        mean, log_variance = pooled.chunk(2, dim=-1)
        return DiagonalGaussian(mean, log_variance.clamp(-10, 10))

    def kl_loss(self, posterior: DiagonalGaussian) -> Float[Tensor, ""]:
        """KL loss (eq. 13) with free bits."""
        return free_bits_kl(posterior.divergence_per_dim(), self.settings.free_bits)

    def reconstruct(
        self,
        motion: Float[Tensor, "B T F"],
        condition: Float[Tensor, "B T C"],
        norm: losses.Norm = "standardised_mean",
    ) -> VAEReconstruction:
        """Reconstruct a true motion given its condition (training)."""
        posterior = self.encode(motion, condition)
        codes = posterior.rsample()
        decoded = self.decode(codes, condition)
        return VAEReconstruction(
            decoded,
            losses.reconstruction(decoded, motion, norm),
            losses.velocity(decoded, motion, norm),
            losses.divergence_as_norm(self.kl_loss(posterior), posterior.mean, norm),
        )

    def sample(
        self, condition: Float[Tensor, "B T C"], generators: Sequence[torch.Generator], temperature: float = 1.0
    ) -> Float[Tensor, "B T F"]:
        """Motion decoded from codes from N(0, temperature^2 I), one random generator per row."""
        shape = (self.latent_count(condition.shape[1]), self.settings.latent)
        codes = temperature * torch.stack([torch.randn(shape, generator=each) for each in generators])
        return self.decode(codes.to(condition), condition)

    def decode(self, codes: Float[Tensor, "B N Z"], condition: Float[Tensor, "B T C"]) -> Float[Tensor, "B T F"]:
        """Motion decoded from codes and a condition."""
        spread = self._interpolate_latents(codes, condition.shape[1])
        out: Tensor = self.out(self.decoder(torch.cat([spread, condition], dim=-1)))
        return out

    def _interpolate_latents(self, codes: Float[Tensor, "B N Z"], frames: int) -> Float[Tensor, "B T Z"]:
        """Codes at their centres, interpolated to frames; divided by the norm of the weights to keep the variance."""
        span = self.settings.latent_frames or CLIP_LATENT_FRAMES
        place = ((torch.arange(frames, device=codes.device) + 0.5) / span - 0.5).clamp(0, codes.shape[1] - 1)
        left = place.floor().long().clamp(max=max(codes.shape[1] - 2, 0))
        right = (left + 1).clamp(max=codes.shape[1] - 1)
        share = (place - left)[:, None]
        norm = torch.where(left == right, torch.ones_like(place), torch.hypot(share[:, 0], 1 - share[:, 0]))[:, None]
        return ((1 - share) * codes[:, left] + share * codes[:, right]) / norm


def free_bits_kl(divergence_per_dim: Float[Tensor, "B N Z"], free_bits: float) -> Float[Tensor, ""]:
    """Mean divergence (nats per dimension). The batch mean of each of the Z dimensions is at least its free bits."""
    if free_bits == 0:
        return divergence_per_dim.mean()
    return divergence_per_dim.mean(dim=(0, 1)).clamp(min=free_bits * math.log(2)).mean()
