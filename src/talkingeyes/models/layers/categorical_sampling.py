"""One category of a distribution, by a uniform number of its own: the same alone and in a batch."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor


def sample_categorical(
    logits: Float[Tensor, "B K"], uniform: Float[Tensor, " B"], temperature: float
) -> Int[Tensor, " B"]:
    """A category by the inverse of the distribution function; temperature 0 takes the most probable."""
    if temperature == 0:
        return logits.argmax(-1)
    cumulative = (logits.double() / temperature).softmax(-1).cumsum(-1)
    return (cumulative < uniform.double()[:, None] * cumulative[:, -1:]).sum(-1).clamp(max=logits.shape[-1] - 1)
