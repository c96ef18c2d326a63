"""Reconstruction and velocity losses of motions (TalkingEyes eq. 11 and 12).

`standardised_mean`: means over frames and dimensions of motions in standard deviations, so that weights mean the same
for head and eyes. `radian_sum`: sums over frames and dimensions of motions in radians, as the paper prints its norms.
"""

from __future__ import annotations

from typing import Literal

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

Norm = Literal["standardised_mean", "radian_sum"]


def reconstruction(
    predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"], norm: Norm = "standardised_mean"
) -> Float[Tensor, ""]:
    """Eq. 11 for one part, mean over the batch."""
    return sum_if_printed(F.mse_loss(predicted.float(), true), true, norm)


def velocity(
    predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"], norm: Norm = "standardised_mean"
) -> Float[Tensor, ""]:
    """Eq. 12 for one part: squared errors of first differences between frames, mean over the batch."""
    change = true.diff(dim=1)
    return sum_if_printed(F.mse_loss(predicted.float().diff(dim=1), change), change, norm)


def sum_if_printed(mean: Float[Tensor, ""], terms: Float[Tensor, "B ..."], norm: Norm) -> Float[Tensor, ""]:
    """The mean of terms of this shape, or their sum over all axes but the batch."""
    return mean * terms[0].numel() if norm == "radian_sum" else mean
