"""The paper's gaze baseline: a conditional VAE given speech and head (TalkingEyes section V-B, "VAE")."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.gaze.generator import GazeCondition
from talkingeyes.models.gaze.saccade_rendering import SEED_OFFSET
from talkingeyes.models.gaze.vqvae import GazeVQVAE
from talkingeyes.models.layers.conditional_vae import ConditionalVAE, VAESettings


class VAEGazeSettings(VAESettings, ComponentSettings):
    """Settings of the VAE of gaze."""

    kind: Literal["vae"]


class VAEGaze(nn.Module):
    """Generator of eye-in-head (6 numbers) from latent codes, all frames at once."""

    mean: Tensor
    scale: Tensor

    settings_class = VAEGazeSettings

    def __init__(self, settings: VAEGazeSettings, speech: int, codebook: GazeVQVAE | None) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(6))
        self.register_buffer("scale", torch.ones(()))
        self.vae = ConditionalVAE(settings, 6, speech + 3)

    def normalise_by(self, mean: Float[Tensor, " 6"], scale: float) -> None:
        """Set the statistics that normalise gaze."""
        self.mean.copy_(mean)
        self.scale.fill_(scale)

    def loss_terms(self, condition: GazeCondition, gaze: Float[Tensor, "B T 2 3"]) -> dict[str, Tensor]:
        """Eq. 11 to 13 for gaze."""
        given = torch.cat([condition.speech, condition.normalised_head], dim=-1)
        found = self.vae.reconstruct((gaze.flatten(2) - self.mean) / self.scale, given)
        return {
            "gaze_reconstruction": found.reconstruction,
            "gaze_velocity": found.velocity,
            "gaze_kl": found.kl,
        }

    @torch.no_grad()
    def sample(self, condition: GazeCondition, seeds: list[int], temperature: float) -> Float[Tensor, "B T 2 3"]:
        """Sample gaze with codes from N(0, temperature^2 I)."""
        given = torch.cat([condition.speech, condition.normalised_head], dim=-1)
        generators = [torch.Generator().manual_seed(seed + SEED_OFFSET) for seed in seeds]
        signal = self.vae.sample(given, generators, temperature) * self.scale + self.mean
        gaze: Tensor = signal.unflatten(-1, (2, 3))
        return gaze
