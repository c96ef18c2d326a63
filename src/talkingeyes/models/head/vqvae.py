"""Head motion by a VQ-VAE, trained together with a gaze decoder: the other choice of TalkingEyes' Tables II and V.

The network is the one of head poses (pose_vqvae.py) for three numbers a frame in place of six. The paper does not say
how its head codes are predicted; here they are categories, drawn one after the other under the speech.
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

# What the network of poses calls the terms of its loss, and what they are called beside those of gaze.
TERM_NAMES = {
    "pose": "head_reconstruction",
    "motion": "head_velocity",
    "commitment": "head_commitment",
    "codes": "head_codes",
}
ROTATION_DIM = 3


class VQVAEHeadSettings(VQVAEPoseSettings):
    """Size of the VQ-VAE of the head."""

    kind: Literal["vqvae"]


class VQVAEHead(nn.Module):
    """Head rotation vectors of speech features. One mean a number and one scale for all normalise inside."""

    settings_class = VQVAEHeadSettings

    def __init__(self, settings: VQVAEHeadSettings, speech: int) -> None:
        super().__init__()
        self.normal = MotionNormaliser(ROTATION_DIM)
        self.codes = VQVAEPose(settings, speech, embedding=0, pose_dim=ROTATION_DIM)

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Through the codebook; codes predicted from those before them (training)."""
        prediction = self.codes.predict(_pose_inputs(speech), self.normal(head))
        loss_terms = {TERM_NAMES[name]: value for name, value in prediction.loss_terms.items()}
        return HeadPrediction(self.normal.denormalise(prediction.pose), loss_terms)

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Motions of drawn codes, a seed a row."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        start = torch.zeros(len(seeds), ROTATION_DIM, device=speech.device)
        return self.normal.denormalise(self.codes.sample(_pose_inputs(speech), start, generators))


def _pose_inputs(speech: Float[Tensor, "B T S"]) -> PoseInputs:
    """Speech as a generator of poses hears it; this one looks at the features alone."""
    return PoseInputs(speech, speech.mean(1), speech)
