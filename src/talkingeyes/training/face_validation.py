"""How good sampled faces are on val: the energy score (Gneiting & Raftery 2007, eq. 22), and whether they move.

    mean |x - y|  -  mean |x - x'| / 2        over samples x of the model and the one face y that was

It is least, in the mean, for samples of the true distribution: a face that is always the mean and one that is diverse
beyond the truth both lose. Of a model that draws nothing it is the mean error.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def energy_score(samples: Float[ndarray, "S T F"], true: Float[ndarray, "T F"]) -> float:
    """Mean over frames; norms of all numbers of a frame. Of one sample, the mean error."""
    error = np.linalg.norm(samples - true, axis=-1).mean()
    count = len(samples)
    if count < 2:
        return float(error)
    apart = [np.linalg.norm(samples[i] - samples[j], axis=-1).mean() for i in range(count) for j in range(i)]
    return float(error - 0.5 * np.mean(apart))


def speed_ratio(samples: Float[ndarray, "S T F"], true: Float[ndarray, "T F"]) -> float:
    """Mean change a frame of samples to the truth's: 0 is frozen, above 1 trembles."""
    change = np.linalg.norm(np.diff(true, axis=0), axis=-1).mean()
    return float(np.linalg.norm(np.diff(samples, axis=1), axis=-1).mean() / max(change, 1e-9))
