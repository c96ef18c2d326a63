"""Head motion by a VQ-VAE, trained together with a gaze decoder: the alternative to the VAE in TalkingEyes' Tables II
and V.

It is the network of head poses (pose_vqvae.py) with three dimensions per frame instead of six. The paper does not say
how head codes are predicted. Here they are categorical, sampled autoregressively given speech.
"""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.head.pose_generator import PoseInputs
from talkingeyes.models.head.pose_vqvae import VQVAEPose, VQVAEPoseSettings
from talkingeyes.models.layers.normaliser import MotionNormaliser

# From the names of the loss terms of the pose network to their names beside those of gaze.
TERM_NAMES = {
    "pose": "head_reconstruction",
    "motion": "head_velocity",
    "commitment": "head_commitment",
    "codes": "head_codes",
}
ROTATION_DIM = 3


class VQVAEHeadSettings(VQVAEPoseSettings):
    """Settings of the VQ-VAE of the head."""

    kind: Literal["vqvae"]


class VQVAEHead(nn.Module):
    """Generator of head rotation vectors from speech features. Normalised internally: a mean per dimension, one scale
    for all."""

    settings_class = VQVAEHeadSettings

    def __init__(self, settings: VQVAEHeadSettings, speech: int) -> None:
        super().__init__()
        self.normal = MotionNormaliser(ROTATION_DIM)
        self.codes = VQVAEPose(settings, speech, embedding=0, pose_dim=ROTATION_DIM)

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Reconstruct through the codebook, and predict each code from the codes before it (training)."""
        prediction = self.codes.predict(_pose_inputs(speech), self.normal(head))
        loss_terms = {TERM_NAMES[name]: value for name, value in prediction.loss_terms.items()}
        return HeadPrediction(self.normal.denormalise(prediction.pose), loss_terms)

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Sample codes and decode them to head motion, one seed per row."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        start = torch.zeros(len(seeds), ROTATION_DIM, device=speech.device)
        return self.normal.denormalise(self.codes.sample(_pose_inputs(speech), start, generators))


def _pose_inputs(speech: Float[Tensor, "B T S"]) -> PoseInputs:
    """Inputs of the pose network, which uses the features alone."""
    return PoseInputs(speech, speech.mean(1), speech)
