"""Nucleus (top-p) sampling: the tail of a distribution is never drawn (Holtzman et al. 2020)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def top_p_filter(logits: Float[Tensor, "B K"], top_p: float, temperature: float) -> Float[Tensor, "B K"]:
    """Logits of the fewest categories whose probabilities, at a temperature, sum to `top_p`; all others barred."""
    if top_p == 1 or temperature == 0:
        return logits
    chances = (logits.double() / temperature).softmax(-1)
    ordered = chances.sort(-1, descending=True)
    before = ordered.values.cumsum(-1) - ordered.values
    kept = torch.zeros_like(chances, dtype=torch.bool).scatter(-1, ordered.indices, before < top_p)
    return logits.masked_fill(~kept, -torch.inf)
