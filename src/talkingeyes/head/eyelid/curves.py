"""Gaze from the contour of the iris.

Elisei, Bailly & Casari (AVSP 2007), section 5.1: the contour of the iris is a plane circle, and gaze is the normal
through its centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import direction_to_angles


@dataclass(frozen=True)
class Circle:
    """A circle in space; its normal points out of the face (z above 0)."""

    centre: Float[ndarray, " 3"]
    normal: Float[ndarray, " 3"]
    radius_m: float

    @property
    def angles_rad(self) -> Float[ndarray, " 2"]:
        """Direction of the normal as (yaw, pitch): the paper's a1 (azimuth) and a2 (elevation)."""
        return direction_to_angles(self.normal)


def fit_circle(contour: Float[ndarray, "K 3"]) -> Circle:
    """Fit a circle to a contour: plane by SVD, centre and radius by linear least squares (Kasa).

    Raises InputError if there are fewer than 3 finite points.
    """
    if len(contour) < 3 or not np.isfinite(contour).all():
        raise InputError(f"iris contour: should be at least 3 finite points, got {len(contour)}")
    middle = contour.mean(axis=0)
    _, _, (first, second, normal) = np.linalg.svd(contour - middle)
    normal = normal if normal[2] > 0 else -normal
    flat = (contour - middle) @ np.stack([first, second], axis=-1)
    rows = np.column_stack([2.0 * flat, np.ones(len(flat))])
    x, y, rest = np.linalg.lstsq(rows, (flat**2).sum(axis=1), rcond=None)[0]
    return Circle(middle + x * first + y * second, normal, float(np.sqrt(rest + x**2 + y**2)))
