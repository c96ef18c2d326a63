"""Causal transformer with a key-value cache; optionally, each layer also attends to a time-aligned memory (eq. 9).

Self-attention covers the last `lookback` frames, so time and memory per step do not grow with the length of the
sequence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.attention import UNLIMITED, KeysValues, WindowAttention


class TransformerSettings(Settings):
    """Size of a causal transformer."""

    width: Annotated[int, Field(gt=0, multiple_of=8)]
    layers: Annotated[int, Field(gt=0)]
    heads: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Number of past positions (frames or codes) in self-attention; null: all.
    lookback: Annotated[int, Field(gt=0)] | None


@dataclass(frozen=True)
class CrossAttentionWindow:
    """Numbers of memory positions before and after its own that a position attends to; None: all."""

    lookback: int | None
    lookahead: int | None


@dataclass
class Cache:
    """Cached keys and values per layer: past self-attention, and the projected memory."""

    position: int
    past: list[KeysValues | None]
    memory: list[KeysValues | None]

    def detach_past(self) -> None:
        """Detach the past of self-attention from the gradient."""
        self.past = [each.detached() if each else None for each in self.past]


class TransformerLayer(nn.Module):
    """Pre-norm layer: self-attention (with `lookahead` future positions), cross-attention to a memory, feed-forward."""

    def __init__(self, settings: TransformerSettings, lookahead: int, cross: CrossAttentionWindow | None) -> None:
        super().__init__()
        width, drop = settings.width, settings.dropout
        self.norm_self, self.norm_feed = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attend_self = WindowAttention(width, settings.heads, settings.lookback, lookahead, drop)
        self.attend_memory = (
            WindowAttention(width, settings.heads, cross.lookback, cross.lookahead, drop) if cross else None
        )
        self.norm_memory = nn.LayerNorm(width) if cross else None
        self.feed = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width), nn.Dropout(drop))

    def forward(self, x: Float[Tensor, "B T W"], memory: Float[Tensor, "B U W"] | None) -> Float[Tensor, "B T W"]:
        normed = self.norm_self(x)
        x = x + self.attend_self(normed, normed)
        if self.attend_memory is not None and self.norm_memory is not None and memory is not None:
            x = x + self.attend_memory(self.norm_memory(x), memory)
        out: Tensor = x + self.feed(self.norm_feed(x))
        return out

    def step(
        self, x: Float[Tensor, "B 1 W"], position: int, past: KeysValues, memory: KeysValues | None
    ) -> Float[Tensor, "B 1 W"]:
        x = x + self.attend_self.step(self.norm_self(x), position, past)
        if self.attend_memory is not None and self.norm_memory is not None and memory is not None:
            x = x + self.attend_memory.step(self.norm_memory(x), position, memory)
        out: Tensor = x + self.feed(self.norm_feed(x))
        return out


class CausalTransformer(nn.Module):
    """Layers and a final norm. `forward` processes whole sequences; `start` and `step` one position at a time."""

    def __init__(self, settings: TransformerSettings, cross: CrossAttentionWindow | None = None) -> None:
        super().__init__()
        self.layers = nn.ModuleList(TransformerLayer(settings, 0, cross) for _ in range(settings.layers))
        self.norm = nn.LayerNorm(settings.width)
        self.lookback = UNLIMITED if settings.lookback is None else settings.lookback

    def forward(
        self, x: Float[Tensor, "B T W"], memory: Float[Tensor, "B U W"] | None = None
    ) -> Float[Tensor, "B T W"]:
        """Features of all positions."""
        for layer in self.layers:
            x = layer(x, memory)
        out: Tensor = self.norm(x)
        return out

    def start(self, memory: Float[Tensor, "B U W"] | None = None, lengths: Int[Tensor, " B"] | None = None) -> Cache:
        """An empty cache, with the memory projected once; `lengths`: frames of each row that are no padding."""
        projected = [
            replace(layer.attend_memory.project(memory), lengths=lengths)  # type: ignore[union-attr, operator]
            if memory is not None
            else None
            for layer in self.layers
        ]
        return Cache(0, [None] * len(self.layers), projected)

    def append_memory(self, memory: Float[Tensor, "B U W"], cache: Cache) -> None:
        """Append the next positions of a streamed memory, and drop those that no later position attends to."""
        for index, layer in enumerate(self.layers):
            attend, known = layer.attend_memory, cache.memory[index]
            assert isinstance(attend, WindowAttention)
            new = attend.project(memory, known.first + known.keys.shape[2] if known else 0)
            known = known.append(new) if known else new
            cache.memory[index] = known.window(cache.position - attend.lookback, new.first + new.keys.shape[2])

    def step(self, x: Float[Tensor, "B 1 W"], cache: Cache) -> Float[Tensor, "B 1 W"]:
        """Features of the next position; updates the cache."""
        for index, layer in enumerate(self.layers):
            assert isinstance(layer, TransformerLayer)
            new = layer.attend_self.project(layer.norm_self(x), cache.position)
            past = cache.past[index]
            past = new if past is None else past.append(new).window(cache.position - self.lookback, cache.position + 1)
            cache.past[index] = past
            x = layer.step(x, cache.position, past, cache.memory[index])
        cache.position += 1
        out: Tensor = self.norm(x)
        return out


def shift_right(x: Float[Tensor, "B T W"], start: Float[Tensor, "B 1 W"] | None = None) -> Float[Tensor, "B T W"]:
    """Shift by one position: the start (None: zeros), then all but the last."""
    return torch.cat([torch.zeros_like(x[:, :1]) if start is None else start, x[:, :-1]], dim=1)
