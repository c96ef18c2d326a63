"""L2 and Diversity, the paper's two distances (section V-B.3, Tables III and V).

Both are means over frames of the Euclidean norm over all six radians of gaze (three of the head), not the root of a
mean of squares. The paper's ratio of Random to Mean, 1.40, is close to the square root of 2 and supports this reading.
A constant near the mean has the best L2 and noise the best Diversity, so neither should be read alone.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray


def distance(
    one: Float[ndarray, "... T C"], other: Float[ndarray, "... T C"], valid: Bool[ndarray, " T"] | None = None
) -> Float[ndarray, ...]:
    """Mean over valid frames of the norm of the difference, in radians. Leading axes are broadcast."""
    norm = np.linalg.norm(one - other, axis=-1)
    return np.asarray(norm.mean(axis=-1) if valid is None else norm[..., valid].mean(axis=-1))


def l2_error(
    samples: Float[ndarray, "S T C"], reference: Float[ndarray, ...], valid: Bool[ndarray, " T"] | None = None
) -> float:
    """L2 of one clip: mean distance of the samples to the reference motion, in radians."""
    return float(distance(samples, reference[None], valid).mean())


def diversity(samples: Float[ndarray, "S T C"], valid: Bool[ndarray, " T"] | None = None) -> float:
    """Diversity of one clip: mean distance between pairs of samples, in radians; NaN for a single sample."""
    if len(samples) < 2:
        return float("nan")
    return float(
        np.concatenate([distance(samples[i + 1 :], samples[i], valid) for i in range(len(samples) - 1)]).mean()
    )
