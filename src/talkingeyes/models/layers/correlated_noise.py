"""Random numbers that change slowly: a standard normal process, the same for a seed alone, in a batch, or a prefix.

Each number is standard normal at every frame, however slow: frames are only tied together. Drawn anew at every frame,
a choice between codes trembles 25 times a second.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


def correlated_normal(seeds: list[int], frames: int, numbers: int, correlation_frames: int) -> Float[Tensor, "B T N"]:
    """White noise under a Hann window of 2 `correlation_frames` - 1 frames, brought back to variance 1; 1: white."""
    window = torch.hann_window(2 * correlation_frames + 1, periodic=False)[1:-1]
    window = window / window.square().sum().sqrt()
    white = torch.stack([_white(seed, frames + len(window) - 1, numbers) for seed in seeds])
    if len(window) == 1:
        return white
    slow = functional.conv1d(white.transpose(1, 2).flatten(0, 1)[:, None], window[None, None])
    return slow.reshape(len(seeds), numbers, frames).transpose(1, 2)


def _white(seed: int, frames: int, numbers: int) -> Float[Tensor, "T N"]:
    """torch draws in sixteens, and the last few otherwise: whole sixteens are drawn, so that a prefix is a prefix."""
    count = frames * numbers
    drawn = torch.randn(-(-count // 16) * 16, generator=torch.Generator().manual_seed(seed))
    return drawn[:count].reshape(frames, numbers)


def normal_to_gumbel(normal: Float[Tensor, "*N"]) -> Float[Tensor, "*N"]:
    """Standard normal numbers as standard Gumbel ones, quantile by quantile: the largest of logits plus these is a
    draw from their softmax (Gumbel 1954)."""
    below = (0.5 * torch.erfc(-normal / math.sqrt(2))).clamp(1e-7, 1 - 1e-7)
    return -(-below.log()).log()
