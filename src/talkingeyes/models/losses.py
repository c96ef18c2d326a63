"""Losses of motions (TalkingEyes eq. 7 and 11 to 14): how the norms of the paper are read.

The paper prints squared norms of sequences and no unit. `radian_sum` is that: sums over frames and numbers, in radians.
`radian_frame_mean` is the mean over frames of sums over numbers, `radian_mean` the mean over both, as libraries compute
it; the divergence, which has no frames, is a sum over the numbers of a code in all three. `standardised_mean` is ours:
means of motions in standard deviations, so that weights mean the same for head and eyes.
"""

from __future__ import annotations

from typing import Literal

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

Norm = Literal["standardised_mean", "radian_mean", "radian_frame_mean", "radian_sum"]


def is_standardised(norm: Norm, standardised: bool) -> bool:
    """Whether networks work on motion in standard deviations."""
    return standardised or norm == "standardised_mean"


def reconstruction(
    predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"], norm: Norm = "standardised_mean"
) -> Float[Tensor, ""]:
    """Eq. 11 for one part, mean over the batch."""
    return as_norm(F.mse_loss(predicted.float(), true), true, norm)


def velocity(
    predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"], norm: Norm = "standardised_mean"
) -> Float[Tensor, ""]:
    """Eq. 12 for one part: squared errors of first differences between frames, mean over the batch."""
    change = true.diff(dim=1)
    return as_norm(F.mse_loss(predicted.float().diff(dim=1), change), change, norm)


def as_norm(mean: Float[Tensor, ""], terms: Float[Tensor, "B T F"], norm: Norm) -> Float[Tensor, ""]:
    """From the mean of squares of this shape to their norm, mean over the batch."""
    if norm == "radian_sum":
        return mean * terms[0].numel()
    return mean * terms.shape[-1] if norm == "radian_frame_mean" else mean


def divergence_as_norm(mean: Float[Tensor, ""], codes: Float[Tensor, "B N Z"], norm: Norm) -> Float[Tensor, ""]:
    """From the mean divergence of the numbers of latent codes to eq. 13."""
    return mean if norm == "standardised_mean" else mean * codes[0].numel()
