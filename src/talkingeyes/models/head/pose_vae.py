"""Head poses by a conditional VAE, as TalkingEyes moves the head (its eq. 8, 11 to 13), here of six numbers."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose import Heard, Memory, PosePrediction
from talkingeyes.models.layers.conditional_vae import ConditionalVAE, VAESettings


class VAEPoseSettings(VAESettings, PartSettings):
    """Size of the VAE."""


class VAEPose(nn.Module):
    """Poses of codes drawn from N(0, I) under speech features."""

    configured_by = VAEPoseSettings
    window = None

    def __init__(self, settings: VAEPoseSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.vae = ConditionalVAE(settings, 6, speech)

    def remember(self, memory: Memory) -> None:
        """It needs nothing."""

    def predict(self, heard: Heard, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Reconstruct true poses under their speech."""
        posterior = self.vae.encode(pose, heard.features)
        made = self.vae.decode(posterior.draw(), heard.features)
        terms = {
            "pose": losses.reconstruction(made, pose),
            "motion": losses.velocity(made, pose),
            "kl": self.vae.penalty(posterior),
        }
        return PosePrediction(made, terms)

    def sample(self, heard: Heard, start: Float[Tensor, "B 6"], noise: list[torch.Generator]) -> Float[Tensor, "B T 6"]:
        """Poses of drawn codes."""
        shape = (self.vae.codes(heard.features.shape[1]), self.vae.settings.latent)
        codes = torch.stack([torch.randn(shape, generator=each) for each in noise])
        return self.vae.decode(codes.to(heard.features), heard.features)
