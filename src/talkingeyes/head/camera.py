"""A pinhole camera in front of the face.

The camera is at (0, 0, distance) and looks along -z, so the subject's left (+x) is on the right of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True)
class Camera:
    """Focal length and principal point in pixels, distance from the neutral head's origin in metres."""

    focal_px: float
    centre_px: tuple[float, float] | list[float]
    distance_m: float
    width: int
    height: int

    def project(self, points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
        """Project points in metres to pixels (origin top left, y down)."""
        depth = self.distance_m - points[..., 2]
        return np.stack(
            [
                self.centre_px[0] + self.focal_px * points[..., 0] / depth,
                self.centre_px[1] - self.focal_px * points[..., 1] / depth,
            ],
            axis=-1,
        )
