"""Head poses of six dimensions by the conditional VAE that TalkingEyes uses for the head (its eq. 8, 11 to 13)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction
from talkingeyes.models.layers.conditional_vae import ConditionalVAE, VAESettings


class VAEPoseSettings(VAESettings, ComponentSettings):
    """Settings of the VAE."""


class VAEPose(nn.Module):
    """Generator of poses from latent codes, sampled from N(0, I), and speech features."""

    settings_class = VAEPoseSettings
    window = None

    def __init__(self, settings: VAEPoseSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.vae = ConditionalVAE(settings, 6, speech)

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Reconstruct true poses given their speech."""
        found = self.vae.reconstruct(pose, inputs.features)
        return PosePrediction(found.motion, {"pose": found.reconstruction, "motion": found.velocity, "kl": found.kl})

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Poses decoded from sampled codes."""
        return self.vae.sample(inputs.features, generators)
