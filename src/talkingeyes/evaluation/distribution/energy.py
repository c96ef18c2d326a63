"""Energy score of samples against the observed motion, by windows (core/energy_score.py)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.energy_score import energy_score


def windowed_energy_score(
    samples: Float[ndarray, "S T C"], observed: Float[ndarray, "T C"], frames: int
) -> Float[ndarray, " W"]:
    """Energy scores of consecutive windows as whole trajectories (root mean square over frames, radians).

    Each window is one vector, so frozen or jittering samples with the right spread are penalised as well.
    """
    count = observed.shape[0] // frames
    shape = (count, frames * observed.shape[1])
    ours = samples[:, : count * frames].reshape(len(samples), *shape)
    return np.asarray(energy_score(ours, observed[: count * frames].reshape(shape)) / np.sqrt(frames))
