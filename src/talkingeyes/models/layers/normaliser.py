"""Normalisation of motion by a mean and a scale that are stored with the weights."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class MotionNormaliser(nn.Module):
    """Mean and scale per dimension; the identity until they are set, or always with `identity`."""

    mean: Tensor
    scale: Tensor

    def __init__(self, numbers: int, identity: bool = False) -> None:
        super().__init__()
        self.identity = identity
        self.register_buffer("mean", torch.zeros(numbers))
        self.register_buffer("scale", torch.ones(numbers))

    def set(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"] | float) -> None:
        """Set the statistics, unless this is the identity; `scale` may be one number for all dimensions."""
        if self.identity:
            return
        self.mean.copy_(mean)
        self.scale.copy_(torch.as_tensor(scale))

    def forward(self, motion: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Normalise a motion."""
        return (motion - self.mean) / self.scale

    def denormalise(self, normal: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Undo the normalisation."""
        return normal * self.scale + self.mean
