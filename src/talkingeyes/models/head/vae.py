"""Head motion from speech by a conditional VAE (TalkingEyes eq. 8, 11 to 13)."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.layers.conditional_vae import ConditionalVAE, VAESettings
from talkingeyes.models.layers.normaliser import MotionNormaliser


class VAEHeadSettings(VAESettings, ComponentSettings):
    """Settings of the VAE of the head."""

    kind: Literal["vae"]
    # Norm of the loss terms.
    norm: losses.Norm
    # Whether the networks work on motion in standard deviations, as always with standardised_mean, or in radians.
    standardised: bool


class VAEHead(nn.Module):
    """Generator of head rotation vectors from speech features. If standardised, with a mean per dimension and one scale
    for all."""

    settings_class = VAEHeadSettings

    def __init__(self, settings: VAEHeadSettings, speech: int) -> None:
        super().__init__()
        self.norm: losses.Norm = settings.norm
        self.normal = MotionNormaliser(3, identity=not losses.is_standardised(settings.norm, settings.standardised))
        self.vae = ConditionalVAE(settings, 3, speech)

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Reconstruct true motion given its speech (training)."""
        found = self.vae.reconstruct(self.normal(head), speech, self.norm)
        unit = 1.0 if self.norm == "standardised_mean" else float(self.normal.scale[0]) ** 2
        loss_terms = {
            "head_reconstruction": unit * found.reconstruction,
            "head_velocity": unit * found.velocity,
            "head_kl": found.kl,
        }
        return HeadPrediction(self.normal.denormalise(found.motion), loss_terms)

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Sample head motion with codes from N(0, I), one seed per row."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        return self.normal.denormalise(self.vae.sample(speech, generators))
