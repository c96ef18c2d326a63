"""Quality of sampled faces on val: the energy score (Gneiting & Raftery 2007, eq. 22) and a ratio of speeds.

    mean |x - y|  -  mean |x - x'| / 2        over samples x of the model and the one observed face y

Its expectation is minimal for samples of the true distribution: it penalises a constant mean face as well as too much
diversity. For a deterministic model it is the mean error.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def energy_score(samples: Float[ndarray, "S T F"], true: Float[ndarray, "T F"]) -> float:
    """Energy score, mean over frames, with norms over all dimensions of a frame; for a single sample, the mean
    error."""
    error = np.linalg.norm(samples - true, axis=-1).mean()
    count = len(samples)
    if count < 2:
        return float(error)
    apart = [np.linalg.norm(samples[i] - samples[j], axis=-1).mean() for i in range(count) for j in range(i)]
    return float(error - 0.5 * np.mean(apart))


def speed_ratio(samples: Float[ndarray, "S T F"], true: Float[ndarray, "T F"]) -> float:
    """Mean change per frame of samples relative to the truth: 0 is frozen, above 1 jitters."""
    change = np.linalg.norm(np.diff(true, axis=0), axis=-1).mean()
    return float(np.linalg.norm(np.diff(samples, axis=1), axis=-1).mean() / max(change, 1e-9))
