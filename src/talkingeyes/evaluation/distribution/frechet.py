"""Frechet distance between two Gaussians of features (Dowson & Landau 1982; Heusel et al. 2017).

d^2 = |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), over the features of windows (encoder.py). It is biased upwards by
about the number of features over the number of windows, so do not read it with fewer than ten windows per feature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True)
class Gaussian:
    """Mean and covariance of features."""

    mean: Float[ndarray, " D"]
    covariance: Float[ndarray, "D D"]


def frechet(one: Gaussian, other: Gaussian) -> float:
    """Squared Frechet distance; tr (S1 S2)^(1/2) from the eigenvalues of the symmetric S1^(1/2) S2 S1^(1/2)."""
    values, vectors = np.linalg.eigh(one.covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    cross = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ other.covariance @ root), 0)).sum()
    apart = np.square(one.mean - other.mean).sum()
    return float(max(0.0, apart + np.trace(one.covariance) + np.trace(other.covariance) - 2 * cross))
