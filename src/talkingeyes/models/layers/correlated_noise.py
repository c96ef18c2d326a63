"""Slowly varying standard normal noise, reproducible per seed: the same alone, in a batch and for a prefix.

The marginal distribution is standard normal at every frame; only successive frames are correlated. With independent
noise in every frame, a choice between codes would flicker 25 times per second.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


def correlated_normal(seeds: list[int], frames: int, numbers: int, correlation_frames: int) -> Float[Tensor, "B T N"]:
    """White noise filtered by a Hann window of 2 `correlation_frames` - 1 frames, scaled to variance 1 (1: white)."""
    window = torch.hann_window(2 * correlation_frames + 1, periodic=False)[1:-1]
    window = window / window.square().sum().sqrt()
    white = torch.stack([_white(seed, frames + len(window) - 1, numbers) for seed in seeds])
    if len(window) == 1:
        return white
    slow = functional.conv1d(white.transpose(1, 2).flatten(0, 1)[:, None], window[None, None])
    return slow.reshape(len(seeds), numbers, frames).transpose(1, 2)


def _white(seed: int, frames: int, numbers: int) -> Float[Tensor, "T N"]:
    """White noise whose prefixes are reproducible. torch samples in blocks of 16 and treats the last few differently,
    so whole blocks are sampled."""
    count = frames * numbers
    normal = torch.randn(-(-count // 16) * 16, generator=torch.Generator().manual_seed(seed))
    return normal[:count].reshape(frames, numbers)


def normal_to_gumbel(normal: Float[Tensor, "*N"]) -> Float[Tensor, "*N"]:
    """Map standard normal numbers to standard Gumbel numbers, quantile by quantile. The argmax of logits plus Gumbel
    noise is a sample from their softmax (Gumbel 1954)."""
    below = (0.5 * torch.erfc(-normal / math.sqrt(2))).clamp(1e-7, 1 - 1e-7)
    return -(-below.log()).log()
