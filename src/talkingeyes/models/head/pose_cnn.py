"""Head poses by a convolutional network alone: the baseline "CNN" of Zhang et al., section 5.2.

It minimises pose and motion distances without an adversary, so it tends to the mean of what could have been: a nearly
static head (their Table 3; docs/posegan.md).
"""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose import Heard, Memory, PosePrediction
from talkingeyes.models.layers.convolution import ConvolutionStack


class CNNPoseSettings(PartSettings):
    """Size of the network."""

    width: Annotated[int, Field(gt=0)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]


class CNNPose(nn.Module):
    """Dilated convolutions over speech features; the same for every seed."""

    configured_by = CNNPoseSettings
    window = None

    def __init__(self, settings: CNNPoseSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.stack = ConvolutionStack(speech, settings.width, settings.layers, settings.dropout)
        self.out = nn.Linear(settings.width, 6)

    def remember(self, memory: Memory) -> None:
        """It needs nothing."""

    def predict(self, heard: Heard, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Distances of pose and motion (eq. 3 without the start)."""
        made: Tensor = self.out(self.stack(heard.features))
        terms = {"pose": losses.reconstruction(made, pose), "motion": losses.velocity(made, pose)}
        return PosePrediction(made, terms)

    def sample(self, heard: Heard, start: Float[Tensor, "B 6"], noise: list[torch.Generator]) -> Float[Tensor, "B T 6"]:
        """The regression."""
        made: Tensor = self.out(self.stack(heard.features))
        return made
