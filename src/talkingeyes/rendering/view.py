"""Views of a head: a camera that looks at a point of the head from an angle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.camera import Camera

ANNY_EYE_CENTRE_M = np.array([0.0, 0.041374, 0.084397])  # midpoint of the eyes of the open head
MIN_CAMERA_DISTANCE_M = 0.2  # to the neutral head's origin: nearer cameras are inside the head or cannot show all of it


@dataclass(frozen=True)
class OrbitCamera:
    """A camera rotated around `pivot` (metres): by `yaw_rad` to the subject's left, then up by `pitch_rad`."""

    camera: Camera
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    pitch_rad: float = 0.0

    @property
    def turn(self) -> Float[ndarray, "3 3"]:
        """Rotation from camera axes to scene axes."""
        sideways, up = rotvec_to_matrix(np.array([[0.0, self.yaw_rad, 0.0], [-self.pitch_rad, 0.0, 0.0]]))
        return np.asarray(sideways @ up)

    @property
    def origin(self) -> Float[ndarray, " 3"]:
        """Position of the camera."""
        return np.asarray(self.turn[:, 2] * self.camera.distance_m + self.pivot)

    def project(self, points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 2"]:
        """Project scene points to pixels."""
        return self.camera.project((points - np.asarray(self.pivot)) @ self.turn)

    def rays(self, pixels: Float[ndarray, "N 2"]) -> Float[ndarray, "N 3"]:
        """Unit directions of the rays through pixels (x, y)."""
        x, y = ((pixels[:, axis] - self.camera.centre_px[axis]) / self.camera.focal_px for axis in range(2))
        rays = np.stack([x, -y, np.full_like(x, -1.0)], axis=-1) @ self.turn.T.astype(pixels.dtype)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Framing:
    """Framing of an image: height at its pivot, pivot, and viewing angles (degrees)."""

    height_m: float
    pivot: tuple[float, float, float]
    distance_m: float = 0.9
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0

    def centred_on(self, eyes: Float[ndarray, "2 3"]) -> Framing:
        """The same framing for a head with other eye positions; pivots are defined for the open head."""
        pivot = np.array(self.pivot) + eyes.mean(axis=0) - ANNY_EYE_CENTRE_M
        return replace(self, pivot=(float(pivot[0]), float(pivot[1]), float(pivot[2])))

    def view(self, width: int, height: int) -> OrbitCamera:
        """The camera for an image of this size. Raises InputError if it would be inside the head."""
        camera = Camera(
            focal_px=height * self.distance_m / self.height_m,
            centre_px=(width / 2, height / 2),
            distance_m=self.distance_m,
            width=width,
            height=height,
        )
        view = OrbitCamera(camera, self.pivot, float(np.radians(self.yaw_deg)), float(np.radians(self.pitch_deg)))
        away = float(np.linalg.norm(view.origin))
        if not away >= MIN_CAMERA_DISTANCE_M:
            raise InputError(
                f"camera: should be at least {MIN_CAMERA_DISTANCE_M} m from the middle of the head, got {away:.3g} m"
            )
        return view


FRAMINGS = {
    "head": Framing(0.285, (0.0, 0.030, 0.0)),
    "face": Framing(0.205, (0.0, 0.010, 0.06)),
    "eyes": Framing(0.058, (0.0, 0.046, 0.09)),
    "left": Framing(0.285, (0.0, 0.030, 0.0), yaw_deg=45.0),
    "right": Framing(0.285, (0.0, 0.030, 0.0), yaw_deg=-45.0),
}
