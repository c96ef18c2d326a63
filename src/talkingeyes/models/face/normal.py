"""Faces in units of their scale, for generators without a prior, which would know it."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Normal(nn.Module):
    """What faces are centred on and divided by."""

    mean: Tensor
    scale: Tensor

    def __init__(self, numbers: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(numbers))
        self.register_buffer("scale", torch.ones(numbers))

    def set(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Take statistics."""
        self.mean.copy_(mean)
        self.scale.copy_(scale)

    def forward(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """In units of the scale."""
        return (face - self.mean) / self.scale

    def back(self, normal: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """In the face's own units."""
        return normal * self.scale + self.mean
