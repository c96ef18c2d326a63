"""Steps that led to the present place: a process (point_process.py) can be told the last ones.

A stroke of the head goes on the way the last one went, and as far. Told places alone, a network has to find
that out, and what it draws turns about too often and too fast (docs/log.md).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

MIN_STEP = 0.05  # in units of the scale: shorter steps have hardly a direction


def encode_step(step: Float[Tensor, "*N D"]) -> Float[Tensor, "*N H"]:
    """Direction and logarithm of the length, D + 1 numbers: small steps have a direction too."""
    length = step.norm(dim=-1, keepdim=True) + MIN_STEP
    return torch.cat([step / length, length.log()], dim=-1)


def previous_step_encodings(locations: Float[Tensor, "B K D"], count: int) -> Float[Tensor, "B K+1 P"]:
    """Headings of the last S steps before each event of a sequence, and after the last (K + 1), the latest first.

    To the first place leads no step.
    """
    step = F.pad(locations.diff(dim=1), (0, 0, 1, 0))
    nth = torch.arange(count, device=locations.device)
    which = torch.arange(-1, locations.shape[1], device=locations.device)[:, None] - nth
    return encode_step(step[:, which.clamp(min=0)]).flatten(-2)
