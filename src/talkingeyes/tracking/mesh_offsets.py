"""Where MediaPipe's points are on the open head: it marks other places of a face than the landmarks of that name.

Measured on rendered heads of three identities in twelve poses, by least squares over the images; between identities
the offsets differ by 1 to 2 mm. MediaPipe's outline is up to 18 mm before that of the head, and its inner eye corner
includes the caruncle.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import LANDMARK_NAMES
from talkingeyes.head.landmarks import head_to_scene, rest_landmarks

# From a landmark of the open head to MediaPipe's point, mm in head axes; of a pair, the left one.
OFFSETS_MM = {
    "nose_bridge": (0.0, -0.5, 1.2),
    "nose_middle": (0.0, -2.8, 7.9),
    "nose_tip": (0.0, -5.2, 3.0),
    "nose_base": (0.0, 2.0, 2.9),
    "nose_wing": (-0.5, -4.2, 0.0),
    "outline_temple": (1.1, -4.4, 17.6),
    "outline_ear": (0.7, 10.4, 14.8),
    "outline_lobe": (0.7, 4.8, 14.4),
    "eye_outer": (-1.0, -0.5, 2.1),
    "eye_inner": (-2.6, -1.0, 2.2),
}


def _offset_m(name: str) -> Float[ndarray, " 3"]:
    side, _, place = name.partition("_")
    found = OFFSETS_MM.get(place if side in ("left", "right") else name, (0.0, 0.0, 0.0))
    return np.array(found) * (-1.0 if side == "right" else 1.0, 1.0, 1.0) / 1000.0


OFFSETS_M = np.stack([_offset_m(name) for name in LANDMARK_NAMES])


def to_head_landmarks(
    mesh: Float[ndarray, "T L 2"], head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"], camera: Camera
) -> Float[ndarray, "T L 2"]:
    """MediaPipe's points moved to the landmarks of the open head, under a first estimate of the head's poses."""
    placed = head_to_scene(np.tile(rest_landmarks(), (len(head), 1, 1)), head, translation)
    moved = placed + np.einsum("tij,lj->tli", rotvec_to_matrix(head), OFFSETS_M)
    return np.asarray(mesh - (camera.project(moved) - camera.project(placed)))
