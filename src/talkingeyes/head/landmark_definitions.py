"""Named landmarks of the open head: lid points on the lid rims, the others by position.

Six points per eye in the order of the eye aspect ratio (Soukupova & Cech 2016), brows, nose, mouth, outline. Lid points
are snapped to the visible edge of the lid, because elsewhere the ratio would not follow the lids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.head.model import Landmarks

SIDES = ("left", "right")
EYE_POINTS = ("outer", "upper_outer", "upper_inner", "inner", "lower_inner", "lower_outer")  # p1 to p6

# Points of the subject's left half, found by a ray from the front at (x, y) in mm. The right half is mirrored.
_FRONT = {
    "brow_outer": (47.0, 60.0),
    "brow_middle": (33.0, 64.0),
    "brow_inner": (14.0, 59.0),
    "nose_wing": (17.0, -1.0),
    "mouth_corner": (24.5, -28.0),
}
# Points of the outline: the vertex nearest to (x, y, z) in mm.
_OUTLINE = {
    "outline_temple": (72.0, 55.0, 30.0),
    "outline_ear": (70.0, 30.0, 25.0),
    "outline_lobe": (68.0, 5.0, 22.0),
    "outline_angle": (63.0, -18.0, 25.0),
    "outline_jaw_back": (55.0, -42.0, 35.0),
    "outline_jaw": (42.0, -60.0, 55.0),
    "outline_jaw_front": (22.0, -72.0, 78.0),
}
_MIDDLE = {
    "nose_bridge": (0.0, 44.0),
    "nose_middle": (0.0, 24.0),
    "nose_tip": (0.0, 5.0),
    "nose_base": (0.0, -8.0),
    "upper_lip": (0.0, -22.0),
    "upper_lip_inner": (0.0, -26.5),
    "lower_lip_inner": (0.0, -29.0),
    "lower_lip": (0.0, -36.0),
    "outline_chin": (0.0, -72.0),
}
_PAIRED = (*_FRONT, *_OUTLINE)
_EYE_NAMES = tuple(f"{side}_eye_{point}" for side in SIDES for point in EYE_POINTS)
LANDMARK_NAMES: tuple[str, ...] = (*_EYE_NAMES, *(f"{side}_{name}" for side in SIDES for name in _PAIRED), *_MIDDLE)
IN_FRONT_M = 0.1  # distance of the origins of rays from the head
EYE_LANDMARKS = np.arange(12).reshape(2, 6)  # indices into LANDMARK_NAMES: eye, then p1 to p6


@dataclass(frozen=True)
class SurfaceHits:
    """Intersections of rays from the front with a surface: face (-1 if none) and barycentric weights (NaN if none)."""

    face: Int[ndarray, " N"]
    barycentric: Float[ndarray, "N 3"]


def cast_from_front(
    points: Float[ndarray, "N 2"], vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]
) -> SurfaceHits:
    """The frontmost face at each (x, y)."""
    from trimesh import Trimesh
    from trimesh.triangles import points_to_barycentric

    mesh = Trimesh(vertices, faces, process=False)
    ahead = np.column_stack([points, np.full(len(points), vertices[:, 2].max() + IN_FRONT_M)])
    places, rays, found = mesh.ray.intersects_location(ahead, np.tile([0.0, 0.0, -1.0], (len(ahead), 1)), False)
    face, barycentric = np.full(len(points), -1), np.full((len(points), 3), np.nan)
    face[rays], barycentric[rays] = found, points_to_barycentric(mesh.triangles[found], places)
    return SurfaceHits(face, barycentric)


def find_landmarks(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], lids: tuple[Int[ndarray, " K"], Int[ndarray, " K"]]
) -> Landmarks:
    """Find all LANDMARK_NAMES on the template. `lids`: the vertices of the visible lid edge of each eye."""
    corners, weights = _lid_points(vertices, lids)
    mirror = np.array([1.0, -1.0])
    front = [np.array(at) * ([sign, 1.0]) for sign in mirror for at in _FRONT.values()]
    hits = cast_from_front(np.array([*front, *_MIDDLE.values()]) / 1000, vertices, faces)
    seen_corners, seen_weights = faces[hits.face], hits.barycentric
    outline = np.array([np.array(at) * [sign, 1.0, 1.0] for sign in mirror for at in _OUTLINE.values()]) / 1000
    nearest = np.linalg.norm(vertices[None] - outline[:, None], axis=-1).argmin(axis=1)
    vertex_corners, vertex_weights = np.repeat(nearest[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(nearest), 1))
    half, ring = len(_FRONT), len(_OUTLINE)
    for side in range(2):
        corners += [seen_corners[side * half : (side + 1) * half], vertex_corners[side * ring : (side + 1) * ring]]
        weights += [seen_weights[side * half : (side + 1) * half], vertex_weights[side * ring : (side + 1) * ring]]
    corners.append(seen_corners[2 * half :])
    weights.append(seen_weights[2 * half :])
    return Landmarks(LANDMARK_NAMES, np.concatenate(corners), np.concatenate(weights))


def _lid_points(
    vertices: Float[ndarray, "V 3"], lids: tuple[Int[ndarray, " K"], Int[ndarray, " K"]]
) -> tuple[list[Int[ndarray, "6 3"]], list[Float[ndarray, "6 3"]]]:
    """p1 to p6 of both eyes: corners are vertices, the others lie a third of the way from each corner."""
    corners, weights = [], []
    for edge, sign in zip(lids, (1.0, -1.0), strict=True):
        upper, lower = lid_curves(vertices, edge, sign)
        x = sign * vertices[:, 0]
        low, high = x[upper[0]], x[upper[-1]]
        thirds = [low + (high - low) * share for share in (2 / 3, 1 / 3)]
        at = [(upper[-1], upper[-1], 0.0), _along(upper, x, thirds[0]), _along(upper, x, thirds[1])]
        at += [(upper[0], upper[0], 0.0), _along(lower, x, thirds[1]), _along(lower, x, thirds[0])]
        corners.append(np.array([[first, second, second] for first, second, _ in at]))
        weights.append(np.array([[1 - share, share, 0.0] for _, _, share in at]))
    return corners, weights


def lid_curves(
    vertices: Float[ndarray, "V 3"], edge: Int[ndarray, " K"], sign: float
) -> tuple[Int[ndarray, " U"], Int[ndarray, " L"]]:
    """Upper and lower lid, each from the inner to the outer corner; `edge` is the ordered loop around the eye."""
    x = sign * vertices[edge, 0]
    turned = np.roll(edge, -int(x.argmin()))
    outer = int((sign * vertices[turned, 0]).argmax())
    one, other = turned[: outer + 1], np.append(turned[:1], turned[outer:][::-1])
    if vertices[one, 1].mean() < vertices[other, 1].mean():
        one, other = other, one
    return one, other


def _along(curve: Int[ndarray, " K"], x: Float[ndarray, " V"], at: float) -> tuple[int, int, float]:
    """The two vertices of a curve between which x passes `at`, and the fraction between them."""
    after = int(np.argmax(x[curve] >= at))
    first, second = int(curve[after - 1]), int(curve[after])
    return first, second, float((at - x[first]) / (x[second] - x[first]))
