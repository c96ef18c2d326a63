"""Hair as ribbons: locks that grow from the scalp along a field of directions, over a smooth hull of the skull.

A lock is a narrow strip. Roots are drawn at random (seeded) from the skin above the hairline; locks lie at different
heights over a solid cap, which keeps skin and background from showing through. Coordinates are those of the head, in
millimetres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

Points = Float[ndarray, "N 3"]
Hull = Callable[[Points], Float[ndarray, " N"]]
CENTRE_MM = np.array([0.0, 50.0, -5.0])  # of the skull: its hull is a distance from here in each direction
ROOT_LIFT_MM = 8.0  # length over which a lock rises from the skin to its height
CAP_LAYER = 0.55  # height of the solid hair under the locks, relative to that of the upper locks
CAP_EDGE_MM = 12.0  # over which it rises from the hairline
CAP_LIFT_MM = 0.3
FACE_MM = 58.0, 84.0  # locks that come before this z below this y are left out
CAP_SHADE, CURTAIN_SHADE = 0.7, 0.9
ACROSS = np.array([-1.0, 1.0])
SEED = 7


@dataclass(frozen=True)
class HairStyle:
    """How hair lies. Directions and heights are functions of positions.

    `flow`: the direction in which hair lies, before it is made tangent to the hull. `height`: the height of the upper
    locks above the skin, mm. `length`: of a lock, from its root. `lowest`: the y at which locks end.
    """

    locks: int
    segments: int  # of a lock
    width_mm: float
    flow: Callable[[Points], Points]
    height: Callable[[Points], Float[ndarray, " N"]]
    length: Callable[[Points], Float[ndarray, " N"]]
    lowest: float = -200.0
    hangs_below: float = -200.0  # y below which hair falls straight, over a curtain behind the ears
    unruly: float = 0.10  # spread of the directions
    twist: float = 0.2  # of locks about their length, up to this slope
    tip: float = 0.12  # width of the end of a lock, relative to its middle


@dataclass(frozen=True)
class HairMesh:
    """Ribbons: `shade` is the lightness of each vertex relative to the hair's colour."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    shade: Float[ndarray, " V"]


def grow_hair(scalp: Points, faces: Int[ndarray, "F 3"], above_mm: Float[ndarray, " V"], style: HairStyle) -> HairMesh:
    """Grow the hair of a style on the skin (mm) that is above the hairline; the other vertices only shape the hull."""
    rng = np.random.default_rng(SEED)
    hull = _hull(scalp)
    values, hairy = clipped(np.column_stack([scalp, above_mm]), faces, above_mm)
    parts = [_locks(_roots(values, hairy, style.locks, rng), hull, style, rng), _cap(values, hairy, style)]
    if style.hangs_below > style.lowest:
        parts.append(_curtain(hull, style))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return HairMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.shade for part in parts]),
    )


def _locks(rooted: Float[ndarray, "N 4"], hull: Hull, style: HairStyle, rng: np.random.Generator) -> HairMesh:
    roots, depth = rooted[:, :3], np.clip(rooted[:, 3] / CAP_EDGE_MM, 0.0, 1.0)
    under = 0.08 + CAP_LAYER * depth * (2 - depth)  # a lock starts on the cap
    layer = np.linspace(0.8, 1.0, len(roots))  # roots come in random order
    share = np.linspace(0, 1, style.segments + 1) ** 1.4  # short pieces at the root, where locks rise and bend
    reached = np.outer(share, style.length(roots) * rng.uniform(0.85, 1.1, len(roots)))
    jitter = rng.normal(0, style.unruly, (len(roots), 3))
    first = _unit(roots - CENTRE_MM)
    paths, ups = [roots + first * (under * style.height(roots))[:, None]], [first]
    at, fell = roots, np.zeros(len(roots), bool)
    for segment in range(1, style.segments + 1):
        up = _unit(at - CENTRE_MM)
        along = style.flow(at) + jitter
        fell |= at[:, 1] < style.hangs_below
        along = _unit(np.where(fell[:, None], along, along - np.einsum("nd,nd->n", along, up)[:, None] * up))
        at = at + (reached[segment] - reached[segment - 1])[:, None] * along
        out = _unit(at - CENTRE_MM)
        gone = np.minimum(reached[segment] / ROOT_LIFT_MM, 1.0)
        rise = under + gone * (layer - under)
        if style.hangs_below <= style.lowest:
            rise *= 1 - 0.4 * (segment / style.segments) ** 2  # tips lie on the hair below
        lain = CENTRE_MM + out * (hull(out) + style.height(at) * rise)[:, None]
        at = np.where(fell[:, None], at, lain)
        at[:, 1] = np.maximum(at[:, 1], style.lowest - 6 * layer)
        paths.append(at)
        ups.append(np.where(fell[:, None], _unit(out * [1.0, 0.0, 1.0]), out))
    lines = np.stack(paths, 1)
    free = ~((lines[..., 2] > FACE_MM[0]) & (lines[..., 1] < FACE_MM[1])).any(axis=1)
    return _ribbons(lines[free], np.stack(ups, 1)[free], style, layer[free], rng)


def _cap(values: Float[ndarray, "V 4"], hairy: Int[ndarray, "F 3"], style: HairStyle) -> HairMesh:
    """The solid hair under the locks."""
    at, rise = values[:, :3], np.clip(values[:, 3] / CAP_EDGE_MM, 0.0, 1.0)
    lifted = at + _unit(at - CENTRE_MM) * (CAP_LAYER * style.height(at) * rise * (2 - rise) + CAP_LIFT_MM)[:, None]
    return HairMesh(lifted, hairy, np.full(len(at), CAP_SHADE))


def _curtain(hull: Hull, style: HairStyle) -> HairMesh:
    """Hair that hangs from the cap around the back of the head, seen from both sides."""
    columns, rows = 33, 4
    around = np.radians(np.linspace(68, 292, columns))
    top = style.hangs_below + 12.0
    out = _unit(np.stack([np.sin(around), np.full(columns, (top - CENTRE_MM[1]) / 90), np.cos(around)], -1))
    rim = CENTRE_MM + out * (hull(out) + CAP_LAYER * style.height(CENTRE_MM + 90 * out))[:, None]
    fall = np.linspace(0, 1, rows)[:, None, None]
    sheet = rim + fall * (np.array([0.0, 1.0, 0.0]) * (style.lowest + 8 - rim[:, 1:2])) - fall * 0.06 * rim * [1, 0, 1]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    front = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, d, c), (a, c, b))])
    shade = np.full(rows * columns, CURTAIN_SHADE)
    return HairMesh(
        np.tile(sheet.reshape(-1, 3), (2, 1)),
        np.concatenate([front, front[:, ::-1] + len(shade)]),
        np.tile(shade, 2),
    )


def _hull(scalp: Points) -> Hull:
    """Distance of the smooth skull from its centre, in each direction."""
    from scipy.interpolate import RBFInterpolator

    out = scalp - CENTRE_MM
    radius = np.linalg.norm(out, axis=1)
    smooth = RBFInterpolator(out / radius[:, None], radius, neighbors=80, smoothing=0.05)
    return lambda directions: np.asarray(smooth(directions))


def _roots(
    values: Float[ndarray, "V 4"], faces: Int[ndarray, "F 3"], count: int, rng: np.random.Generator
) -> Float[ndarray, "N 4"]:
    """Points on the faces, evenly spread, in random order, with their heights above the hairline."""
    from scipy.spatial import cKDTree

    corners = values[faces]
    edges = corners[:, 1:, :3] - corners[:, :1, :3]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    drawn = rng.choice(len(faces), 8 * count, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), len(drawn))
    points = np.einsum("nk,nkd->nd", weights, corners[drawn])
    spacing = np.sqrt(areas.sum() / 2 / count)
    free, chosen = np.ones(len(points), bool), list[int]()
    tree = cKDTree(points[:, :3])
    for index in range(len(points)):
        if free[index] and len(chosen) < count:
            chosen.append(index)
            free[tree.query_ball_point(points[index, :3], 0.78 * spacing)] = False
    return np.asarray(rng.permutation(points[chosen]))


def _ribbons(
    paths: Float[ndarray, "N K 3"],
    ups: Float[ndarray, "N K 3"],
    style: HairStyle,
    layer: Float[ndarray, " N"],
    rng: np.random.Generator,
) -> HairMesh:
    count, knots = paths.shape[:2]
    along = np.gradient(paths, axis=1)
    side = _unit(np.cross(along, ups).reshape(-1, 3)).reshape(paths.shape)
    share = np.linspace(0, 1, knots) ** 1.4
    taper = np.interp(share, [0, 0.2, 0.6, 1.0], [0.25, 1.0, 0.95, style.tip])
    half = 0.5 * style.width_mm * taper * rng.uniform(0.7, 1.25, (count, 1))
    points = paths[:, :, None] + side[:, :, None] * (half[..., None] * ACROSS)[..., None]
    points += (
        ups[:, :, None] * (rng.uniform(-style.twist, style.twist, (count, 1, 1)) * half[..., None] * ACROSS)[..., None]
    )  # tilted
    lock = (
        np.clip(rng.normal(1.0, 0.2, (count, 1, 1)), 0.65, 1.5) * np.interp(layer, [0.8, 1], [0.8, 1.05])[:, None, None]
    )
    shade = lock * np.interp(share, [0, 0.25, 1], [0.72, 1.0, 1.12])[None, :, None] * (1 + 0.10 * ACROSS)
    index = np.arange(count * knots * 2).reshape(count, knots, 2)
    (a, b), (d, c) = np.moveaxis(index[:, :-1], -1, 0), np.moveaxis(index[:, 1:], -1, 0)
    faces = np.concatenate([np.stack(corners, -1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])
    return HairMesh(points.reshape(-1, 3), faces, np.broadcast_to(shade, index.shape).reshape(-1))


def clipped(
    values: Float[ndarray, "V C"], faces: Int[ndarray, "F 3"], height: Float[ndarray, " V"]
) -> tuple[Float[ndarray, "W C"], Int[ndarray, "G 3"]]:
    """The part of a mesh where `height` is positive; vertex values are interpolated along cut edges."""
    rows, made, kept = list(values), {}, []

    def between(first: int, second: int) -> int:
        key = (min(first, second), max(first, second))
        if key not in made:
            share = height[key[0]] / (height[key[0]] - height[key[1]])
            rows.append(values[key[0]] + share * (values[key[1]] - values[key[0]]))
            made[key] = len(rows) - 1
        return made[key]

    for face in faces.tolist():
        polygon = []
        for first, second in zip(face, face[1:] + face[:1], strict=True):
            if height[first] > 0:
                polygon.append(first)
            if (height[first] > 0) != (height[second] > 0):
                polygon.append(between(first, second))
        kept += [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]
    used, index = np.unique(np.array(kept), return_inverse=True)
    return np.array(rows)[used], index.reshape(-1, 3)


def _unit(vectors: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 3"]:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))
