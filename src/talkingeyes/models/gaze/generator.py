"""What every gaze generator is: it predicts true gaze in training and samples gaze for speech and a head motion.

A generator is one file here: `categorical`, `regressed` (the paper) or `vae` (the paper's baseline).
"""

from __future__ import annotations

from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

# Gaze draws must not repeat the numbers that the head drew from the same seed.
SEED_OFFSET = 1_000_003


class GazeGenerator(Protocol):
    """`head` is in radians; `head_normal` the same in units of its standard deviation, as the condition."""

    def terms(
        self,
        speech: Float[Tensor, "B T S"],
        head_normal: Float[Tensor, "B T 3"],
        head: Float[Tensor, "B T 3"],
        gaze: Float[Tensor, "B T 2 3"],
    ) -> dict[str, Tensor]:
        """Named terms of the loss for true motion; `head_normal` may be a reconstruction of `head`."""
        ...

    def sample(
        self,
        speech: Float[Tensor, "B T S"],
        head_normal: Float[Tensor, "B T 3"],
        head: Float[Tensor, "B T 3"],
        seeds: list[int],
        temperature: float,
    ) -> Float[Tensor, "B T 2 3"]:
        """Eye-in-head rotation vectors, a seed a row."""
        ...


def uniforms(seeds: list[int], count: int) -> Float[Tensor, "B N"]:
    """Uniform numbers, a seed a row: the same for a seed alone or in a batch, and for a prefix."""
    return torch.stack(
        [torch.rand(count, generator=torch.Generator().manual_seed(seed + SEED_OFFSET)) for seed in seeds]
    )
