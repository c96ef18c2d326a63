"""The lids of a head on any mesh: the contour of the eye opening, the brow anchor, and the skin between.

No vertex lists are needed: seen along the optical axis, the lids are the skin nearest to it. Rays from the axis in all
directions intersect the edges of the skin; the nearest intersection of a ray is a point of the contour. Coordinates of
a region are those of its eye: origin at the eyeball's centre, +x towards the temple on both sides, y up, +z out of the
face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.head.eyelid.model import ANCHOR, LOWER, POINTS, UPPER
from talkingeyes.head.model import PARTS, HeadModel, Landmarks

MAX_LID_DISTANCE_M = 0.045  # skin further from the eye does not belong to its lids
ANCHOR_HEIGHT_M, CHEEK_DEPTH_M = 0.017, 0.015  # distance from the eye's centre at which the skin stops following a lid
EYEBALL_M = 0.0125
SMOOTH_DEGREE = 3
CORNER_SKIN = 0.6  # how far beyond a corner the skin moves with it, relative to the width of the eye
DIRECTIONS = 180
SKIN = [PARTS.index("skin"), PARTS.index("brow")]
TEMPORAL_AXES = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])  # from head axes to those of the left and right region


@dataclass(frozen=True)
class EyelidRegion:
    """One eye of a head: its curves as points of the surface, and the vertices around them that lids may move.

    `points` are those of the curves, then those of the vertices. `along` runs from 0 at the inner to 1 at the outer
    corner. `upper_share` and `lower_share` are the weights with which a point follows the upper and the lower lid.
    """

    eye: int
    centre: Float[ndarray, " 3"]
    curves: Landmarks
    vertices: Int[ndarray, " Q"]
    points: Float[ndarray, "N 3"]
    along: Float[ndarray, " N"]
    upper_share: Float[ndarray, " N"]
    lower_share: Float[ndarray, " N"]

    @property
    def upper(self) -> Float[ndarray, "U 3"]:
        return self.points[UPPER]

    @property
    def lower(self) -> Float[ndarray, "U 3"]:
        return self.points[LOWER]

    def spread(self, curves: Float[ndarray, "N P 3"]) -> Float[ndarray, "N Q 3"]:
        """Displacements of the vertices for displacements of the curves: those of the nearest lid, fading with it.

        They are smooth along a lid, a polynomial, and horizontal at the corners, so that the skin does not crumple.
        """
        inside = np.clip(self.along, 0.0, 1.0)
        beyond = 1.0 - smoothstep(np.abs(self.along - inside) / CORNER_SKIN)
        powers = np.polynomial.legendre.legvander(2.0 * inside - 1.0, SMOOTH_DEGREE)
        moved = np.zeros((len(curves), len(self.vertices), 3))
        for lid, share in ((UPPER, self.upper_share), (LOWER, self.lower_share)):
            across = (beyond * share**2)[POINTS:, None] * powers[POINTS:] @ np.linalg.pinv(powers[lid])
            spread = np.stack([across, *2 * [across * (4.0 * inside * (1.0 - inside))[POINTS:, None]]])
            moved += np.einsum("dqp,npd->nqd", spread, curves[:, lid])
        return moved


def eyelid_region(model: HeadModel, eye: int) -> EyelidRegion:
    """Find the lids of one eye. Raises InputError if the mesh has no skin around it."""
    centre, axes = model.eye_centres[eye], TEMPORAL_AXES[eye]
    local = (model.template - centre) * axes
    skin = model.faces[np.isin(model.parts, SKIN)]
    near = (np.linalg.norm(local[skin], axis=-1) < MAX_LID_DISTANCE_M).all(axis=1) & (local[skin][..., 2] > 0).all(
        axis=1
    )
    if near.sum() < DIRECTIONS // 4:
        raise InputError(f"head {model.name}: should have skin in front of both eyes, got {near.sum()} triangles")
    around = skin[near]
    contour = _contour(local, around)
    curves = _curves(local, contour, np.unique(around))
    vertices = np.unique(around)
    points = np.concatenate([curves.of(local), local[vertices]])
    along, upper, lower = _shares(points)
    return EyelidRegion(eye, centre, curves, vertices, points, along, upper, lower)


def _contour(local: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Landmarks:
    """The inner edge of the skin in DIRECTIONS around the optical axis, counter-clockwise from +x."""
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    origin, way = local[edges[:, 0]], local[edges[:, 1]] - local[edges[:, 0]]
    start, step = origin[:, :2], way[:, :2]
    found = []
    for angle in np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False):
        ray = np.array([np.cos(angle), np.sin(angle)])
        across = ray[0] * step[:, 1] - ray[1] * step[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            radius = (start[:, 0] * step[:, 1] - start[:, 1] * step[:, 0]) / across
            share = (start[:, 0] * ray[1] - start[:, 1] * ray[0]) / across
        radius[~((share >= 0) & (share <= 1) & (radius > 0))] = np.inf
        share = np.clip(np.nan_to_num(share), 0.0, 1.0)
        deep = np.linalg.norm(origin + share[:, None] * way, axis=1) < EYEBALL_M
        radius[deep] = np.inf  # the margin behind the rim, hidden in the eyeball
        nearest = int(np.argmin(radius))
        if np.isfinite(radius[nearest]):
            found.append((*edges[nearest], share[nearest]))
    rows = np.array(found).reshape(-1, 3)
    corners = rows[:, [0, 1, 1]].astype(np.int64)
    weights = np.stack([1 - rows[:, 2], rows[:, 2], np.zeros(len(rows))], axis=-1)
    return Landmarks((), corners, weights)


def _curves(local: Float[ndarray, "V 3"], contour: Landmarks, vertices: Int[ndarray, " Q"]) -> Landmarks:
    """Upper lid, lower lid and brow anchor, resampled from the inner to the outer corner, as points of the surface."""
    points = contour.of(local)
    outer = int(np.argmax(points[:, 0]))
    order = np.roll(np.arange(len(points)), -outer)  # from the outer corner over the upper lid to the inner one
    inner = int(np.argmin(points[order, 0]))
    upper, lower = order[: inner + 1][::-1], np.append(order[inner:], order[0])
    chosen = np.concatenate(
        [_evenly(points, upper, UPPER.stop - UPPER.start), _evenly(points, lower, LOWER.stop - LOWER.start)]
    )
    across = np.linspace(points[order[inner], 0], points[outer, 0], ANCHOR.stop - ANCHOR.start)
    anchors = []
    for x in across:
        away = np.hypot(local[vertices, 0] - x, local[vertices, 1] - ANCHOR_HEIGHT_M)
        anchors.append(vertices[int(np.argmin(away))])
    corners = np.concatenate([contour.corners[chosen], np.repeat(anchors, 3).reshape(-1, 3)])
    weights = np.concatenate([contour.barycentric[chosen], np.tile([1.0, 0.0, 0.0], (len(anchors), 1))])
    return Landmarks((), corners, weights)


def _evenly(points: Float[ndarray, "K 3"], path: Int[ndarray, " M"], count: int) -> Int[ndarray, " N"]:
    """The `count` points of a path nearest to equal steps of arc length."""
    steps = np.linalg.norm(np.diff(points[path], axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, length[-1], count)
    return np.asarray(path[np.abs(length[None] - wanted[:, None]).argmin(axis=1)])


def _shares(
    points: Float[ndarray, "N 3"],
) -> tuple[Float[ndarray, " N"], Float[ndarray, " N"], Float[ndarray, " N"]]:
    """Position between the corners, and weights of each point for the upper and the lower lid."""
    inner, outer = points[UPPER][0, 0], points[UPPER][-1, 0]
    along = (points[:, 0] - inner) / (outer - inner)
    height = elevation(points)
    upper, lower = (np.interp(along, *_profile(points[lid], inner, outer)) for lid in (UPPER, LOWER))
    depth = np.maximum(points[:, 2], 0.010)
    top, bottom = np.arctan2(ANCHOR_HEIGHT_M, depth), np.arctan2(-CHEEK_DEPTH_M, depth)
    middle = (upper + lower) / 2
    from_upper = 1.0 - smoothstep((height - upper) / np.maximum(top - upper, 0.1))
    from_lower = 1.0 - smoothstep((lower - height) / np.maximum(lower - bottom, 0.1))
    upper_share, lower_share = np.where(height >= middle, from_upper, 0.0), np.where(height < middle, from_lower, 0.0)
    upper_share[UPPER], lower_share[UPPER] = 1.0, 0.0
    upper_share[LOWER], lower_share[LOWER] = 0.0, 1.0
    return along, upper_share, lower_share


def _profile(
    curve: Float[ndarray, "U 3"], inner: float, outer: float
) -> tuple[Float[ndarray, " U"], Float[ndarray, " U"]]:
    """Elevation of a lid over its position between the corners, in ascending order."""
    place = (curve[:, 0] - inner) / (outer - inner)
    order = np.argsort(place, kind="stable")
    return place[order], elevation(curve)[order]


def elevation(points: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N"]:
    """Angle above the horizontal plane through the eye's centre, about its axis from corner to corner."""
    return np.asarray(np.arctan2(points[..., 1], points[..., 2]))


def smoothstep(x: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """0 below 0, 1 above 1, smooth between."""
    clipped = np.clip(x, 0.0, 1.0)
    return np.asarray(clipped**2 * (3.0 - 2.0 * clipped))
