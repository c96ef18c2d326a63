"""Residual dilated convolutions over time: any length, linear time, a fixed reach on both sides."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class ConvolutionStack(nn.Module):
    """Layers of kernel 5 with dilation 1, 2, 4, ...: a reach of 2 (2^layers - 1) frames to each side."""

    def __init__(self, channels_in: int, width: int, layers: int, dropout: float) -> None:
        super().__init__()
        self.enter = nn.Linear(channels_in, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers))
        self.convolutions = nn.ModuleList(
            nn.Conv1d(width, width, kernel_size=5, padding=2 * 2**layer, dilation=2**layer) for layer in range(layers)
        )
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features a frame."""
        h: Tensor = self.enter(x)
        for norm, convolution in zip(self.norms, self.convolutions, strict=True):
            h = h + self.drop(convolution(F.gelu(norm(h)).transpose(1, 2)).transpose(1, 2))
        return h
