"""How hard the codes of a VAE are drawn to their prior: annealing and free bits (beside TalkingEyes eq. 13).

Early in training a strong divergence empties the codes before the decoder has learnt to read them. Linear annealing
(Bowman et al. 2016) lets its weight rise from 0; cyclical annealing (Fu et al. 2019) does so again and again: along the
first half of each cycle it rises, along the second it is whole. Free bits (Kingma et al. 2016, eq. 15) do not count a
number of the code for less than so much information, so that nothing is gained by emptying it altogether.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.schedules import ramp


class AnnealingSettings(Settings):
    """How the weight of the divergence rises."""

    shape: Literal["linear", "cyclical"]
    # Steps of training until it is whole (linear), or of one cycle.
    steps: Annotated[int, Field(gt=1)]


class KLSettings(Settings):
    """What is made of the divergence."""

    # null: the weight of the loss from the first step on.
    annealing: AnnealingSettings | None
    # Bits a number of the code that cost nothing; 0: none.
    free_bits: Annotated[float, Field(ge=0)]


def annealing_weight(settings: AnnealingSettings | None, trained_steps: int) -> float:
    """The share of its weight that the divergence has, 0 to 1."""
    if settings is None:
        return 1.0
    if settings.shape == "linear":
        return ramp(trained_steps, settings.steps)
    return min(1.0, 2 * (trained_steps % settings.steps) / settings.steps)


def free_bits_kl(divergence_per_dim: Float[Tensor, "B N Z"], free_bits: float) -> Float[Tensor, ""]:
    """The mean divergence (nats a number); over the batch, each of the Z numbers counts for its free bits at least."""
    if free_bits == 0:
        return divergence_per_dim.mean()
    return divergence_per_dim.mean(dim=(0, 1)).clamp(min=free_bits * math.log(2)).mean()
