"""A pinhole camera anywhere in the scene, as calibration gives it: OpenCV's convention.

A scene point p is at q = R p + t in the camera's axes (x right, y down, z ahead), and at centre + focal q_xy / q_z in
the image, without distortion. The camera of `camera.Camera` has the rotation vector (pi, 0, 0) and the translation
(0, 0, distance).
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.core.settings import Settings

# Bounds far beyond any camera: numbers near the largest that there are cannot be squared.
Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Point = tuple[Coordinate, Coordinate]


class CalibratedCamera(Settings):
    """Focal length and principal point in pixels; rotation vector (radians) and translation (metres) of the scene."""

    focal_px: Annotated[float, Field(ge=1, le=1e6)]
    centre_px: Point
    rotation: Vector
    translation_m: Vector

    @cached_property
    def turn(self) -> Float[ndarray, "3 3"]:
        """Rotation from the scene to the camera."""
        return rotvec_to_matrix(np.array(self.rotation))

    @property
    def origin(self) -> Float[ndarray, " 3"]:
        """Position of the camera in the scene."""
        return np.asarray(-np.array(self.translation_m) @ self.turn)

    def project(self, points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
        """Project scene points to pixels (origin top left, y down)."""
        seen = points @ self.turn.T + np.array(self.translation_m)
        return np.asarray(np.array(self.centre_px) + self.focal_px * seen[..., :2] / seen[..., 2:])

    def rays(self, pixels: Float[ndarray, "N 2"]) -> Float[ndarray, "N 3"]:
        """Unit directions of the rays through pixels (x, y)."""
        flat = (pixels - np.array(self.centre_px)) / self.focal_px
        rays = np.column_stack([flat, np.ones(len(flat))]) @ self.turn
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
