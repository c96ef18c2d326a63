"""The random numbers of torch's generator on the CPU, in numpy: samples of a seed do not depend on what computes them.

Both are MT19937 (Matsumoto & Nishimura 1998). A uniform number takes 24 bits of a word; normal numbers are made in
blocks of 16 by the Box-Muller transform (Box & Muller 1958).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

SEED_MASK, MANTISSA_BITS, BLOCK = 2**32 - 1, 24, 16


def uniform(seed: int, count: int) -> Float[ndarray, " N"]:
    """`torch.rand(count)` for a seed, bit for bit."""
    words = np.random.RandomState(seed & SEED_MASK).randint(2**32, size=count, dtype=np.uint32)
    return (words & np.uint32(2**MANTISSA_BITS - 1)).astype(np.float32) * np.float32(2.0**-MANTISSA_BITS)


def normal(seed: int, count: int) -> Float[ndarray, " N"]:
    """`torch.randn(count)` for a seed, up to rounding; `count` should be a multiple of 16."""
    radius_number, angle_number = uniform(seed, count).reshape(-1, 2, BLOCK // 2).transpose(1, 0, 2)
    radius, angle = np.sqrt(-2 * np.log(1 - radius_number)), np.float32(2 * math.pi) * angle_number
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).reshape(-1)
