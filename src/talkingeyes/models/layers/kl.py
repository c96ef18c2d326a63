"""KL annealing and free bits for VAEs (extensions of TalkingEyes eq. 13).

Early in training, a strong divergence empties the codes before the decoder has learned to use them (posterior
collapse). Linear annealing (Bowman et al. 2016) raises the weight from 0. Cyclical annealing (Fu et al. 2019) repeats
this: the weight rises over the first half of each cycle and is 1 over the second. Free bits (Kingma et al. 2016, eq.
15) put a lower bound on the divergence of each dimension, so that emptying a dimension completely does not reduce the
loss.
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
    """Schedule of the weight of the divergence."""

    shape: Literal["linear", "cyclical"]
    # Training steps until the weight is 1 (linear), or of one cycle.
    steps: Annotated[int, Field(gt=1)]


class KLSettings(Settings):
    """Settings of the divergence term."""

    # null: full weight from the first step on.
    annealing: AnnealingSettings | None
    # Free bits per latent dimension; 0: none.
    free_bits: Annotated[float, Field(ge=0)]


def annealing_weight(settings: AnnealingSettings | None, trained_steps: int) -> float:
    """Factor on the weight of the divergence, 0 to 1."""
    if settings is None:
        return 1.0
    if settings.shape == "linear":
        return ramp(trained_steps, settings.steps)
    return min(1.0, 2 * (trained_steps % settings.steps) / settings.steps)


def free_bits_kl(divergence_per_dim: Float[Tensor, "B N Z"], free_bits: float) -> Float[Tensor, ""]:
    """Mean divergence (nats per dimension). The batch mean of each of the Z dimensions is at least its free bits."""
    if free_bits == 0:
        return divergence_per_dim.mean()
    return divergence_per_dim.mean(dim=(0, 1)).clamp(min=free_bits * math.log(2)).mean()
