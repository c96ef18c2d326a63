"""Nucleus (top-p) sampling: cuts the tail of a distribution (Holtzman et al. 2020)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def top_p_filter(logits: Float[Tensor, "B K"], top_p: float, temperature: float) -> Float[Tensor, "B K"]:
    """Keep the fewest categories whose probabilities at the temperature sum to `top_p`; other logits become -inf."""
    if top_p == 1 or temperature == 0:
        return logits
    chances = (logits.double() / temperature).softmax(-1)
    ordered = chances.sort(-1, descending=True)
    before = ordered.values.cumsum(-1) - ordered.values
    kept = torch.zeros_like(chances, dtype=torch.bool).scatter(-1, ordered.indices, before < top_p)
    return logits.masked_fill(~kept, -torch.inf)
