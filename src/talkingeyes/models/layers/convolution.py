"""Residual dilated convolutions over time: any length, linear time, a fixed reach, on both sides or into the past."""

from __future__ import annotations

import torch
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


class CausalConvolutionStack(nn.Module):
    """The same layers without a look ahead: a frame hears itself and the 4 (2^layers - 1) frames before it.

    `ahead` frames may be heard all the same: what is given for frame t is what the layers say at frame t + ahead, and
    past the end they hear zeros. `start` and `step` do it part by part, for streams.
    """

    def __init__(self, channels_in: int, width: int, layers: int, dropout: float, ahead: int) -> None:
        super().__init__()
        self.ahead = ahead
        self.enter = nn.Linear(channels_in, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers))
        self.convolutions = nn.ModuleList(
            nn.Conv1d(width, width, kernel_size=5, dilation=2**layer) for layer in range(layers)
        )
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features a frame."""
        return self.step(F.pad(x, (0, 0, 0, self.ahead)), self.start(len(x)))[:, self.ahead :]

    def start(self, batch: int) -> list[Float[Tensor, "B _ W"]]:
        """What each layer has heard before the first frame: silence."""
        width = self.enter.out_features
        return [self.enter.weight.new_zeros(batch, 4 * 2**layer, width) for layer in range(len(self.norms))]

    def step(self, x: Float[Tensor, "B T C"], past: list[Float[Tensor, "B _ W"]]) -> Float[Tensor, "B T W"]:
        """What the layers say at the next frames (those of `ahead` frames ago); `past` moves on."""
        h: Tensor = self.enter(x)
        for layer, (norm, convolution) in enumerate(zip(self.norms, self.convolutions, strict=True)):
            heard = torch.cat([past[layer], F.gelu(norm(h))], dim=1)
            past[layer] = heard[:, heard.shape[1] - past[layer].shape[1] :]
            h = h + self.drop(convolution(heard.transpose(1, 2)).transpose(1, 2))
        return h
