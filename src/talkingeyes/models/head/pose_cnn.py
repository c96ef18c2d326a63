"""Head poses by a convolutional network alone: the baseline "CNN" of Zhang et al., section 5.2.

It minimises pose and motion distances without an adversarial loss, so it tends to the mean of all plausible motions: a
nearly static head (their Table 3; docs/posegan.md).
"""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction
from talkingeyes.models.layers.convolution import ConvolutionStack


class CNNPoseSettings(ComponentSettings):
    """Size of the network."""

    width: Annotated[int, Field(gt=0)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]


class CNNPose(nn.Module):
    """Dilated convolutions over speech features. Deterministic: all seeds give the same poses."""

    settings_class = CNNPoseSettings
    window = None

    def __init__(self, settings: CNNPoseSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.stack = ConvolutionStack(speech, settings.width, settings.layers, settings.dropout)
        self.out = nn.Linear(settings.width, 6)

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Pose and motion distances (eq. 3 without the initial pose)."""
        generated: Tensor = self.out(self.stack(inputs.features))
        loss_terms = {"pose": losses.reconstruction(generated, pose), "motion": losses.velocity(generated, pose)}
        return PosePrediction(generated, loss_terms)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """The regressed poses, the same for every row's generator."""
        generated: Tensor = self.out(self.stack(inputs.features))
        return generated
