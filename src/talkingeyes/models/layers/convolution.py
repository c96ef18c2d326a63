"""Residual dilated convolutions over time: any length, linear time, a fixed reach, on both sides or into the past."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor, nn

from talkingeyes.models.layers.numpy_layers import NumpyCausalConv, NumpyLayerNorm, NumpyLinear, gelu


class ConvolutionStack(nn.Module):
    """Layers of kernel 5 with dilation 1, 2, 4, ...: a reach of 2 (2^layers - 1) frames to each side."""

    def __init__(self, channels_in: int, width: int, layers: int, dropout: float) -> None:
        super().__init__()
        self.input_projection = nn.Linear(channels_in, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers))
        self.convolutions = nn.ModuleList(
            nn.Conv1d(width, width, kernel_size=5, padding=2 * 2**layer, dilation=2**layer) for layer in range(layers)
        )
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features a frame."""
        h: Tensor = self.input_projection(x)
        for norm, convolution in zip(self.norms, self.convolutions, strict=True):
            h = h + self.drop(convolution(F.gelu(norm(h)).transpose(1, 2)).transpose(1, 2))
        return h


class CausalConvolutionStack(nn.Module):
    """The same layers without a look ahead: a frame hears itself and the 4 (2^layers - 1) frames before it.

    `lookahead` frames may be heard all the same: what is given for frame t is what the layers say at frame t + ahead,
    and past the end they hear zeros. `stream` does it part by part.
    """

    def __init__(self, channels_in: int, width: int, layers: int, dropout: float, lookahead: int) -> None:
        super().__init__()
        self.lookahead = lookahead
        self.input_projection = nn.Linear(channels_in, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers))
        self.convolutions = nn.ModuleList(
            nn.Conv1d(width, width, kernel_size=5, dilation=2**layer) for layer in range(layers)
        )
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features a frame."""
        h: Tensor = self.input_projection(F.pad(x, (0, 0, 0, self.lookahead)))
        for layer, (norm, convolution) in enumerate(zip(self.norms, self.convolutions, strict=True)):
            padded = F.pad(F.gelu(norm(h)), (0, 0, 4 * 2**layer, 0))
            h = h + self.drop(convolution(padded.transpose(1, 2)).transpose(1, 2))
        return h[:, self.lookahead :]

    def stream(self) -> ConvolutionStream:
        """The layers as they are now, before the first frame of one stream."""
        return ConvolutionStream(self)


class ConvolutionStream:
    """Causal layers that hear part after part."""

    def __init__(self, stack: CausalConvolutionStack) -> None:
        self._enter = NumpyLinear(stack.input_projection)
        pairs = zip(stack.norms, stack.convolutions, strict=True)
        self._layers = [(NumpyLayerNorm(norm), NumpyCausalConv(each)) for norm, each in pairs]  # type: ignore[arg-type]

    def step(self, x: Float[ndarray, "T C"]) -> Float[ndarray, "T W"]:
        """What the layers say at the next frames (those of `lookahead` frames ago)."""
        h = self._enter(x)
        for norm, convolution in self._layers:
            h = h + convolution(gelu(norm(h)))
        return h
