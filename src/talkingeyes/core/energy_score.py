"""Energy score of S samples against the observed motion: a proper scoring rule (Gneiting & Raftery 2007, eq. 21).

ES = E |X - y| - 1/2 E |X - X'|: the first term is the error, the second the spread of the samples. Its mean is lowest
for samples from the true distribution given the sound; the mean pose, which has the best L2, is penalised for its
missing spread. Pairs of a sample with itself are left out (the fair score, Ferro 2014), so that small S is not
penalised.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def energy_score(samples: Float[ndarray, "S *N C"], observed: Float[ndarray, "*N C"]) -> Float[ndarray, "*N"]:
    """Energy score of each of N vectors, in the unit of the vectors. NaN for a single sample."""
    count = len(samples)
    error = np.linalg.norm(samples - observed, axis=-1).mean(axis=0)
    if count < 2:
        return np.full_like(error, np.nan)
    between = [np.linalg.norm(samples[i + 1 :] - samples[i], axis=-1).sum(axis=0) for i in range(count - 1)]
    return np.asarray(error - np.sum(between, axis=0) / (count * (count - 1)))
