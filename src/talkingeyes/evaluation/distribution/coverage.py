"""Coverage and precision: do the samples include what people do, and nothing else?

In the features of windows, precision is the fraction of samples inside the k-nearest-neighbour ball of any true window
(Kynkaanniemi et al. 2019). Coverage is the fraction of true windows whose ball holds a sample (Naeem et al. 2020). A
constant near the mean has a good precision and a low coverage, and noise the opposite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.distance import cdist

from talkingeyes.evaluation.distribution.mmd import WindowFeatures


@dataclass(frozen=True)
class PrecisionCoverage:
    """For each sampled window whether it lies in a ball of the truth; for each true window whether its ball has one."""

    precise: Float[ndarray, " N"]
    covered: Float[ndarray, " M"]


def precision_coverage(samples: WindowFeatures, reference: WindowFeatures, neighbours: int) -> PrecisionCoverage:
    """Compute precision and coverage of windows.

    The radius of a ball is the distance to the k-th neighbour among true windows of other clips, as windows of one clip
    are too similar. Truth compared with itself covers itself: compare it with other takes.
    """
    among = cdist(reference.features, reference.features)
    among[reference.clip[:, None] == reference.clip] = np.inf
    radius = np.partition(among, neighbours - 1, axis=1)[:, neighbours - 1]
    across = cdist(samples.features, reference.features)
    inside = across <= radius
    return PrecisionCoverage(inside.any(axis=1).astype(float), inside.any(axis=0).astype(float))
