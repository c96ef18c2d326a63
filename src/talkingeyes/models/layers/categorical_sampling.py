"""Categorical sampling by one uniform number per row, so that a row does not depend on the rest of the batch."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor


def sample_categorical(
    logits: Float[Tensor, "B K"], uniform: Float[Tensor, " B"], temperature: float
) -> Int[Tensor, " B"]:
    """Sample a category by inverting the cumulative distribution; temperature 0 returns the most probable one."""
    if temperature == 0:
        return logits.argmax(-1)
    cumulative = (logits.double() / temperature).softmax(-1).cumsum(-1)
    return (cumulative < uniform.double()[:, None] * cumulative[:, -1:]).sum(-1).clamp(max=logits.shape[-1] - 1)
