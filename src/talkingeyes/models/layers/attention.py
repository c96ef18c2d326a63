"""Windowed attention with rotary relative positions (Su et al. 2021).

Frame t of the query attends to frames t - lookback .. t + lookahead of the memory. Positions are relative and the
window is fixed, so the cost of a step does not depend on the length of the sequence. The cached and the parallel pass
give the same result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

BLOCK_FRAMES = 512  # frames
UNLIMITED = 2**31  # frames of a window that covers any memory


@dataclass
class KeysValues:
    """Keys and values of a memory, for frames `first` .. first + length - 1."""

    keys: Float[Tensor, "B H U D"]
    values: Float[Tensor, "B H U D"]
    first: int
    # Frames of each row from position 0, in a batch of memories of several lengths; None: all rows are full.
    lengths: Int[Tensor, " B"] | None = None

    def window(self, start: int, stop: int) -> KeysValues:
        """Frames start .. stop - 1 (absolute positions), as far as they are stored."""
        low = max(start - self.first, 0)
        high = max(stop - self.first, 0)
        return replace(self, keys=self.keys[:, :, low:high], values=self.values[:, :, low:high], first=self.first + low)

    def filled(self, position: int) -> Bool[Tensor, "B 1 1 U"] | None:
        """Which frames are no padding; None: all. In rows that end before `position`, all frames up to it count."""
        stop = self.first + self.keys.shape[2]
        if self.lengths is None or int(self.lengths.min()) >= stop:
            return None
        order = torch.arange(self.first, stop, device=self.keys.device)
        return (order < self.lengths.clamp(min=position + 1)[:, None])[:, None, None]

    def detached(self) -> KeysValues:
        """A copy without gradient."""
        return replace(self, keys=self.keys.detach(), values=self.values.detach())

    def append(self, other: KeysValues) -> KeysValues:
        """This memory with the next frames appended."""
        keys, values = torch.cat([self.keys, other.keys], dim=2), torch.cat([self.values, other.values], dim=2)
        return replace(self, keys=keys, values=values)


class WindowAttention(nn.Module):
    """Multi-head attention to a window of a memory; self-attention if the memory is the query."""

    frequencies: Tensor

    def __init__(self, width: int, heads: int, lookback: int | None, lookahead: int | None, dropout: float) -> None:
        """`lookback` and `lookahead`: frames of the window; None: all."""
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.lookback = UNLIMITED if lookback is None else lookback
        self.lookahead = UNLIMITED if lookahead is None else lookahead
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)
        frequencies = 1.0 / (10_000 ** (torch.arange(0, width // heads, 2) / (width // heads)))
        self.register_buffer("frequencies", frequencies, persistent=False)

    def project(self, memory: Float[Tensor, "B U W"], first: int = 0) -> KeysValues:
        """Keys and values of memory frames that start at position `first`."""
        keys, values = self._split(self.key_value(memory), 2)
        return KeysValues(self._rotate(keys, first), values, first)

    def forward(self, x: Float[Tensor, "B T W"], memory: Float[Tensor, "B U W"]) -> Float[Tensor, "B T W"]:
        """Attend in all frames; both sequences start at position 0. Works in blocks of frames, so that memory stays
        linear."""
        projected = self.project(memory)
        blocks = range(0, max(x.shape[1], 1), BLOCK_FRAMES)
        return torch.cat([self._block(x[:, start : start + BLOCK_FRAMES], start, projected) for start in blocks], dim=1)

    def _block(self, x: Float[Tensor, "B T W"], first: int, memory: KeysValues) -> Float[Tensor, "B T W"]:
        """Attend in the frames from `first` on, each to its window of the memory."""
        seen = memory.window(first - self.lookback, first + x.shape[1] + self.lookahead)
        offset = torch.arange(seen.keys.shape[2]) + seen.first - (torch.arange(x.shape[1]) + first)[:, None]
        allowed = (offset >= -self.lookback) & (offset <= self.lookahead)
        return self._attend(x, first, seen, allowed.to(x.device))

    def step(self, x: Float[Tensor, "B 1 W"], position: int, memory: KeysValues) -> Float[Tensor, "B 1 W"]:
        """Attend in a single frame at `position`."""
        seen = memory.window(position - self.lookback, position + self.lookahead + 1)
        return self._attend(x, position, seen, seen.filled(position))

    def _attend(
        self, x: Float[Tensor, "B T W"], first: int, memory: KeysValues, allowed: Bool[Tensor, "*#B T U"] | None
    ) -> Float[Tensor, "B T W"]:
        (query,) = self._split(self.query(x), 1)
        mixed = F.scaled_dot_product_attention(
            self._rotate(query, first),
            memory.keys,
            memory.values,
            attn_mask=allowed,
            dropout_p=self.dropout if self.training else 0.0,
        )
        out: Tensor = self.out(mixed.transpose(1, 2).flatten(2))
        return out

    def _split(self, x: Float[Tensor, "B T W"], parts: int) -> tuple[Tensor, ...]:
        batch, frames, width = x.shape
        return x.view(batch, frames, parts, self.heads, width // parts // self.heads).permute(2, 0, 3, 1, 4).unbind(0)

    def _rotate(self, x: Float[Tensor, "B H T D"], first: int) -> Float[Tensor, "B H T D"]:
        angle = torch.arange(first, first + x.shape[2], device=x.device)[:, None] * self.frequencies
        cosine, sine = angle.cos(), angle.sin()
        even, odd = x[..., 0::2], x[..., 1::2]
        return torch.stack([even * cosine - odd * sine, even * sine + odd * cosine], dim=-1).flatten(-2)
