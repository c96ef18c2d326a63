"""Motion in units of its scale: what a network is centred on and divided by, kept with its weights."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class MotionNormaliser(nn.Module):
    """Statistics of the numbers of a frame; until they are set nothing changes."""

    mean: Tensor
    scale: Tensor

    def __init__(self, numbers: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(numbers))
        self.register_buffer("scale", torch.ones(numbers))

    def set(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"] | float) -> None:
        """Take statistics; one scale may be for all numbers."""
        self.mean.copy_(mean)
        self.scale.copy_(torch.as_tensor(scale))

    def forward(self, motion: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """In units of the scale."""
        return (motion - self.mean) / self.scale

    def denormalise(self, normal: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """In the motion's own units."""
        return normal * self.scale + self.mean
