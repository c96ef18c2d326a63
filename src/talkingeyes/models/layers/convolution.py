"""Residual dilated convolutions over time, symmetric or causal: any length, linear time, a fixed receptive field."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor, nn

from talkingeyes.models.layers.numpy_layers import NumpyCausalConv, NumpyLayerNorm, NumpyLinear, module_tensors


def torch_gelu(x: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """GELU of an array by torch."""
    return F.gelu(torch.from_numpy(x)).numpy()


class ConvolutionStack(nn.Module):
    """Layers of kernel 5 with dilation 1, 2, 4, ...; symmetric, or causal with a lookahead.

    Symmetric (`lookahead` is None), a frame depends on 2 (2^layers - 1) frames to each side. Causal layers depend on
    the frame itself and on the 4 (2^layers - 1) frames before it; the output for frame t is theirs at frame
    t + lookahead, where inputs past the end are zeros. `streaming` computes the same part by part.
    """

    def __init__(self, channels_in: int, width: int, layers: int, dropout: float, lookahead: int | None = None) -> None:
        super().__init__()
        self.lookahead = lookahead
        self.input_projection = nn.Linear(channels_in, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers))
        self.convolutions = nn.ModuleList(
            nn.Conv1d(width, width, kernel_size=5, padding=2 * 2**layer if lookahead is None else 0, dilation=2**layer)
            for layer in range(layers)
        )
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features per frame."""
        ahead = self.lookahead or 0
        h: Tensor = self.input_projection(F.pad(x, (0, 0, 0, ahead)))
        for layer, (norm, convolution) in enumerate(zip(self.norms, self.convolutions, strict=True)):
            inner = F.gelu(norm(h))
            if self.lookahead is not None:
                inner = F.pad(inner, (0, 0, 4 * 2**layer, 0))
            h = h + self.drop(convolution(inner.transpose(1, 2)).transpose(1, 2))
        return h[:, ahead:]

    def streaming(self) -> StreamingConvolutions:
        """These causal layers for streams, with a copy of the current weights."""
        assert self.lookahead is not None
        return StreamingConvolutions(self)


class StreamingConvolutions:
    """Causal convolutions that process sequences part by part, many sequences at once."""

    def __init__(self, stack: ConvolutionStack) -> None:
        tensors = module_tensors(stack)
        self._enter = NumpyLinear(tensors, "input_projection")
        self._layers = [
            (NumpyLayerNorm(tensors, f"norms.{layer}"), NumpyCausalConv(tensors, f"convolutions.{layer}", 2**layer))
            for layer in range(len(stack.norms))
        ]
        self._past_shape = (
            sum(convolution.reach for _, convolution in self._layers),
            stack.input_projection.out_features,
        )

    def begin(self) -> Float[ndarray, "P W"]:
        """The inputs of all layers before the first frame: zeros."""
        return np.zeros(self._past_shape, np.float32)

    def step(
        self, past: Float[ndarray, "B P W"], x: Float[ndarray, "B T C"]
    ) -> tuple[Float[ndarray, "B T W"], Float[ndarray, "B P W"]]:
        """Features of the next frames, delayed by `lookahead` frames, and the inputs that later frames need."""
        h, frames, first, kept = self._enter(x), x.shape[1], 0, []
        for norm, convolution in self._layers:
            entered = np.concatenate([past[:, first : first + convolution.reach], torch_gelu(norm(h))], axis=1)
            kept.append(entered[:, frames:])
            first += convolution.reach
            h = h + convolution(entered)
        return h, np.concatenate([past[:, :0], *kept], axis=1)
