"""Vertex colours of the open head: skin, lips, lash line, brows, short hair, and ambient occlusion.

MakeHuman's body has no colours with a usable license, so colours depend on the position of a vertex at rest. Brows are
separate narrow meshes just above the skin: the body's vertices are 5 mm apart, too coarse for a brow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.head.landmark_definitions import cast_from_front
from talkingeyes.head.model import Landmarks
from talkingeyes.head.normals import vertex_normals

SKIN, LIP, HAIR, LASH, WET = (
    np.array(colour)
    for colour in (
        (0.62, 0.37, 0.27),
        (0.46, 0.17, 0.16),
        (0.060, 0.036, 0.024),
        (0.10, 0.05, 0.04),
        (0.50, 0.20, 0.17),
    )
)
INTERIOR_COLOURS = {
    "teeth": np.array([0.72, 0.68, 0.60]),
    "tongue": np.array([0.42, 0.14, 0.14]),
    "tissue": np.array([0.42, 0.16, 0.14]),
}
BROW_LIFT_M = 0.0006
# The left brow from the inner to the outer end: x, y of its centre line and half its width, mm.
_BROW = np.array(
    [(11.0, 57.0, 2.6), (18.0, 59.6, 3.4), (26.0, 62.2, 3.3), (34.0, 63.8, 2.8), (42.0, 63.0, 2.0), (49.0, 59.4, 0.9)]
)
BROW_COLUMNS, BROW_ROWS = 28, 5
AMBIENT_RAYS = 64
AMBIENT_REACH_M = 0.08


@dataclass(frozen=True)
class BrowStrip:
    """A strip on the skin: the points under its vertices, its triangles and colours."""

    attachment: Landmarks
    faces: Int[ndarray, "F 3"]
    colours: Float[ndarray, "V 3"]


def skin_colours(
    vertices: Float[ndarray, "V 3"],
    lips: Float[ndarray, " V"],
    lash_line: Int[ndarray, " K"],
    inner_rim: Int[ndarray, " K"],
) -> Float[ndarray, "V 3"]:
    """Skin albedo from position (head coordinates), the mask of the lips and the rims of the lids."""
    x, y, z = vertices.T * 1000
    flush = (
        0.5 * spot(np.abs(x) - 42, y - 8, 22.0) + 0.5 * spot(x, y - 6, 14.0) + 0.6 * spot(np.abs(x) - 78, y - 30, 20.0)
    )
    colour = SKIN * (1 + flush[:, None] * np.array([0.06, -0.14, -0.16]))
    colour = mixed(colour, LIP, np.clip(1.4 * lips - 0.2, 0, 1) * (z > 60))
    hair = ramp(_hairline(x, y, z), -3.0, 5.0)
    colour = mixed(colour, HAIR, 0.93 * hair)
    colour[inner_rim] = WET
    colour[lash_line] = LASH
    return colour


def _hairline(x: Float[ndarray, " V"], y: Float[ndarray, " V"], z: Float[ndarray, " V"]) -> Float[ndarray, " V"]:
    """Millimetres above the hairline: over the forehead, down before the ears, round the nape."""
    around_deg = np.degrees(np.arctan2(np.abs(x), z))
    height = np.interp(
        around_deg, [0, 25, 38, 50, 62, 74, 84, 100, 130, 180], [106, 103, 94, 76, 58, 38, 30, 12, -12, -22]
    )
    return np.asarray(y - height - np.where(is_ear(x, y, z), 200, 0))


def is_ear(x: Float[ndarray, " V"], y: Float[ndarray, " V"], z: Float[ndarray, " V"]) -> ndarray:
    return np.asarray((np.abs(x) > 71) & (y < 62) & (y > -10) & (z > -25))


def build_brow(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], skin: Float[ndarray, "V 3"], sign: float
) -> BrowStrip:
    """The left (sign 1) or right (-1) brow: dark along the centre line, skin-coloured at the edge."""
    along = np.linspace(0, 1, BROW_COLUMNS)
    knots = np.linspace(0, 1, len(_BROW))
    x, y, half = (smooth(along, knots, column) for column in _BROW.T)
    across = np.linspace(-1, 1, BROW_ROWS)
    slope = np.gradient(y, x)
    lean = across[:, None] * half / np.hypot(1, slope)
    points = np.stack([sign * (x - slope * lean), y + lean], axis=-1).reshape(-1, 2) / 1000
    hits = cast_from_front(points, vertices, faces)
    ends = np.minimum(1, np.minimum(along / 0.12 + 0.15, (1 - along) / 0.1))
    depth = 0.92 * ((1 - across**2)[:, None] ** 0.5 * ends)
    attachment = Landmarks((), faces[hits.face], hits.barycentric)
    colours = mixed(attachment.of(skin), HAIR * 1.4, np.clip(depth, 0, 1).ravel())
    return BrowStrip(attachment, grid(BROW_ROWS, BROW_COLUMNS, sign), colours)


def ambient_occlusion(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, " V"]:
    """Cosine-weighted fraction of the hemisphere above each vertex without an occluder within 8 cm."""
    from trimesh import Trimesh

    normals = vertex_normals(vertices[None], faces)[0]
    normals[~normals.any(axis=1)] = [0.0, 0.0, 1.0]  # vertices without faces
    index = np.arange(AMBIENT_RAYS) + 0.5
    cosine, turn = np.sqrt(1 - index / AMBIENT_RAYS), np.pi * (1 + 5**0.5) * index
    sine = np.sqrt(1 - cosine**2)
    local = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)
    helper = np.where(np.abs(normals[:, :1]) > 0.7, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=1)
    rays = np.einsum("kj,vji->vki", local, frame).reshape(-1, 3)
    starts = np.repeat(vertices + 3e-4 * normals, AMBIENT_RAYS, axis=0)
    places, hit, _ = Trimesh(vertices, faces, process=False).ray.intersects_location(starts, rays, multiple_hits=False)
    seen = np.ones(len(rays), bool)
    seen[hit] = np.linalg.norm(places - starts[hit], axis=1) > AMBIENT_REACH_M
    return np.asarray(seen.reshape(len(vertices), AMBIENT_RAYS).mean(axis=1))


def spot(x: Float[ndarray, " V"], y: Float[ndarray, " V"], radius: float) -> Float[ndarray, " V"]:
    return np.asarray(np.exp(-(x**2 + y**2) / (2 * (radius / 2) ** 2)))


def ramp(value: Float[ndarray, " V"], low: float, high: float) -> Float[ndarray, " V"]:
    share = np.clip((value - low) / (high - low), 0, 1)
    return np.asarray(share**2 * (3 - 2 * share))


def mixed(
    colour: Float[ndarray, "V 3"], other: Float[ndarray, " 3"], share: Float[ndarray, " V"]
) -> Float[ndarray, "V 3"]:
    return np.asarray(colour + share[:, None] * (other - colour))


def smooth(at: Float[ndarray, " N"], knots: Float[ndarray, " K"], values: Float[ndarray, " K"]) -> Float[ndarray, " N"]:
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(knots, values)(at))


def grid(rows: int, columns: int, sign: float) -> Int[ndarray, "F 3"]:
    """Triangles of a grid of vertices, counter-clockwise from the front."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above = corner + 1, corner + columns
    faces = np.concatenate([np.stack([corner, right, above + 1], -1), np.stack([corner, above + 1, above], -1)])
    return faces if sign > 0 else faces[:, ::-1]
