"""Bidirectional transformer with a fixed attention window, after one convolution (ProbTalk3D section 3.3).

The paper attends to the whole clip with absolute positions. A fixed window with relative positions has linear cost, so
that speech of any length can be decoded. The layers are those of the causal transformer, with lookahead.
"""

from __future__ import annotations

from typing import Annotated

from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.models.layers.transformer import TransformerLayer, TransformerSettings


class WindowTransformerSettings(TransformerSettings):
    """Size of the transformer. Each layer attends to `lookback` past and `lookahead` future frames; `kernel` is that of
    the convolution."""

    lookahead: Annotated[int, Field(ge=0)]
    kernel: Annotated[int, Field(gt=0)]


class WindowTransformer(nn.Module):
    """Linear projection, convolution over time, attention layers and final norm."""

    def __init__(self, settings: WindowTransformerSettings, channels: int) -> None:
        super().__init__()
        self.input_projection = nn.Linear(channels, settings.width)
        self.convolution = nn.Conv1d(settings.width, settings.width, settings.kernel, padding="same")
        self.layers = nn.ModuleList(
            TransformerLayer(settings, settings.lookahead, None) for _ in range(settings.layers)
        )
        self.norm = nn.LayerNorm(settings.width)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features per frame."""
        entered = self.input_projection(x)
        h = entered + self.convolution(entered.transpose(1, 2)).transpose(1, 2)
        for layer in self.layers:
            h = layer(h, None)
        out: Tensor = self.norm(h)
        return out
