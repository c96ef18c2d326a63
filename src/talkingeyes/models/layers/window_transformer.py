"""A transformer that looks both ways over a fixed reach, behind one convolution (ProbTalk3D section 3.3).

The paper attends to the whole clip with absolute positions; a fixed reach with relative ones costs linear time, so
that speech of any length can be decoded. It takes the layers of the causal transformer, with frames ahead.
"""

from __future__ import annotations

from typing import Annotated

from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.models.layers.transformer import TransformerLayer, TransformerSettings


class WindowTransformerSettings(TransformerSettings):
    """Size of a transformer that looks `lookback` and `lookahead` frames in each layer; `kernel` of the convolution."""

    lookahead: Annotated[int, Field(ge=0)]
    kernel: Annotated[int, Field(gt=0)]


class WindowTransformer(nn.Module):
    """A linear projection, a convolution over time, layers of attention, a final norm."""

    def __init__(self, settings: WindowTransformerSettings, channels: int) -> None:
        super().__init__()
        self.input_projection = nn.Linear(channels, settings.width)
        self.convolution = nn.Conv1d(settings.width, settings.width, settings.kernel, padding="same")
        self.layers = nn.ModuleList(
            TransformerLayer(settings, settings.lookahead, None) for _ in range(settings.layers)
        )
        self.norm = nn.LayerNorm(settings.width)

    def forward(self, x: Float[Tensor, "B T C"]) -> Float[Tensor, "B T W"]:
        """Features a frame."""
        entered = self.input_projection(x)
        h = entered + self.convolution(entered.transpose(1, 2)).transpose(1, 2)
        for layer in self.layers:
            h = layer(h, None)
        out: Tensor = self.norm(h)
        return out
