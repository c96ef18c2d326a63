"""Reconstruction and velocity losses of motions (TalkingEyes eq. 11 and 12), as means over frames and dimensions.

Motions are in standard deviations, so that weights mean the same for head and eyes.
"""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def reconstruction(predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"]) -> Float[Tensor, ""]:
    """Eq. 11 for one part."""
    return F.mse_loss(predicted.float(), true)


def velocity(predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"]) -> Float[Tensor, ""]:
    """Eq. 12 for one part: the mean squared error of first differences between frames."""
    return F.mse_loss(predicted.float().diff(dim=1), true.diff(dim=1))
