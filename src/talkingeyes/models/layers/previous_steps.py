"""Encodings of the steps that led to the present location, an optional input of the point process (point_process.py).

A movement segment of the head tends to continue in the direction of the last one, and as far. Given locations alone, a
network has to infer this, and its samples reverse too often and too fast (docs/log.md).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from talkingeyes.models.layers.numpy_point_process import MIN_STEP


def encode_step(step: Float[Tensor, "*N D"]) -> Float[Tensor, "*N H"]:
    """Direction and log length of a step, D + 1 numbers. MIN_STEP is added to the length."""
    length = step.norm(dim=-1, keepdim=True) + MIN_STEP
    return torch.cat([step / length, length.log()], dim=-1)


def previous_step_encodings(locations: Float[Tensor, "B K D"], count: int) -> Float[Tensor, "B K+1 P"]:
    """Encodings of the last S steps before each event and after the last event (K + 1 rows), the latest first.

    No step leads to the first location.
    """
    step = F.pad(locations.diff(dim=1), (0, 0, 1, 0))
    nth = torch.arange(count, device=locations.device)
    which = torch.arange(-1, locations.shape[1], device=locations.device)[:, None] - nth
    return encode_step(step[:, which.clamp(min=0)]).flatten(-2)
