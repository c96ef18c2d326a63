"""Looks: the open head as one of three people with hair, brows, lashes, teeth and shoulders, for pictures and exports.

A look shapes the face by the head's identity shapes, paints it, and adds geometry that no landmark lies on, so motion,
corpus and fits know nothing of it. Faces are scaled and shifted as in `landmarks`: eyes and pupils are in the same
places in every look. A look is a file of this package; `python -m talkingeyes.head.looks_build` makes them again.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.npz import save_npz
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.anatomy import EyelidParameters
from talkingeyes.head.eyelid.blendshapes import with_eyelids
from talkingeyes.head.eyelid.model import EyelidModel
from talkingeyes.head.model import PARTS, HeadModel, Landmarks

LOOKS = ("ada", "ben", "chi")
DEFAULT_LOOK = "ada"
LOOK_FILE = str(Path(__file__).parent / "assets" / "look_{}.npz")


@dataclass(frozen=True)
class Look:
    """What dresses the open head. `moved` displaces vertices of the head. `vertices` follow those of the head without
    its brows, and so do their attributes.

    An added vertex moves with a point of the skin (`corners`, `barycentric`); without weights, only with the joints.
    """

    identity: Float[ndarray, " I"]
    moved: Float[ndarray, "N 3"]
    faces: Int[ndarray, "F 3"]
    parts: Int[ndarray, " F"]
    colours: Float[ndarray, "V 3"]
    ambient: Float[ndarray, " V"]
    vertices: Float[ndarray, "A 3"]
    weights: Float[ndarray, "A 5"]
    corners: Int[ndarray, "A 3"]
    barycentric: Float[ndarray, "A 3"]


def check_look(name: str) -> None:
    """Raises InputError for a name that is not one of LOOKS."""
    if name not in LOOKS:
        raise InputError(f"look: should be one of {', '.join(LOOKS)}, got {name!r}")


def load_look(name: str) -> Look:
    """Read a look of this package. Raises InputError for another name."""
    check_look(name)
    names = [field.name for field in fields(Look)]
    return Look(**read_npz(Path(LOOK_FILE.format(name)), set(names), "look"))


def save_look(look: Look, name: str) -> None:
    """Write a look into this package."""
    with atomic_write(Path(LOOK_FILE.format(name))) as partial:
        save_npz(partial, **{field.name: getattr(look, field.name) for field in fields(Look)})


def dressed_head(name: str = DEFAULT_LOOK, person: tuple[EyelidModel, EyelidModel] | None = None) -> HeadModel:
    """The open head with a look of this package, by name; `person` as in `dress`."""
    return dress(anny_head(), load_look(name), person)


def dress(head: HeadModel, look: Look, person: tuple[EyelidModel, EyelidModel] | None = None) -> HeadModel:
    """The open head with a look. `person`: models of a person's left and right eye (`eyelid.blendshapes`)."""
    shaped = shape_face(head, look.identity)
    bare = with_eyelids(replace(shaped, template=shaped.template + look.moved), EyelidParameters(), person)
    count, added = len(bare.template), len(look.vertices)
    brow = np.unique(look.faces[look.parts == PARTS.index("brow")]) - count
    return replace(
        bare,
        template=np.concatenate([bare.template, look.vertices]),
        faces=look.faces,
        parts=look.parts,
        colours=look.colours,
        ambient=look.ambient,
        identity=np.zeros((0, count + added, 3), np.float32),
        expression=np.concatenate([bare.expression, _carried(bare, look)], axis=1),
        correctives=np.zeros((0, count + added, 3), np.float32),
        weights=np.concatenate([bare.weights, look.weights]),
        brows=Landmarks((), look.corners[brow], look.barycentric[brow]),
    )


def shape_face(head: HeadModel, identity: Float[ndarray, " I"]) -> HeadModel:
    """The open head without brows, with the face of a person of the head's identity shapes, its eyes kept in place."""
    kept = int(head.vertices_of("brow").min())  # the brows come last
    moved = np.tensordot(identity, head.identity[:, :kept], axes=1)
    shifted = np.tensordot(identity, head.identity_joints, axes=1)
    joints = head.joints + shifted
    rest, middle = head.eye_centres.mean(axis=0), joints[3:].mean(axis=0)
    scale = float((head.eye_centres[0, 0] - head.eye_centres[1, 0]) / (joints[3, 0] - joints[4, 0]))
    template = rest + scale * (head.template[:kept] + moved - middle)
    eyes = head.vertices_of("sclera", "iris", "pupil")
    template[eyes] = head.template[eyes]
    joints = rest + scale * (joints - middle)
    joints[[1, 3, 4]] = head.joints[[1, 3, 4]]
    faces = (head.faces < kept).all(axis=1)
    return replace(
        head,
        template=template.astype(np.float32),
        faces=head.faces[faces],
        parts=head.parts[faces],
        colours=head.colours[:kept],
        ambient=head.ambient[:kept],
        identity=np.zeros((0, kept, 3), np.float32),
        identity_joints=np.zeros((0, 5, 3), np.float32),
        identity_names=(),
        expression=(scale * head.expression[:, :kept]).astype(np.float32),
        correctives=np.zeros((0, kept, 3), np.float32),
        joints=joints.astype(np.float32),
        weights=head.weights[:kept],
    )


def _carried(bare: HeadModel, look: Look) -> Float[ndarray, "E A 3"]:
    """Displacements of the added vertices: those of their points of the skin; lashes turn about the eye with them."""
    skin = Landmarks((), look.corners, look.barycentric)
    moved = skin.of(bare.expression).astype(np.float32)
    lash = np.unique(look.faces[look.parts == PARTS.index("lash")]) - len(bare.template)
    roots = skin.of(bare.template)[lash]
    eyes = bare.eye_centres[(roots[:, 0] < 0).astype(int)]
    before, out = _unit(roots - eyes), look.vertices[lash] - roots
    for shape in moved:
        if shape[lash].any():
            across = np.cross(before, _unit(roots + shape[lash] - eyes))
            sine = np.linalg.norm(across, axis=1, keepdims=True)
            turns = rotvec_to_matrix(across * np.arcsin(sine) / np.maximum(sine, 1e-12))
            shape[lash] += np.einsum("nij,nj->ni", turns, out) - out
    return moved


def _unit(vectors: Float[ndarray, "N 3"]) -> Float[ndarray, "N 3"]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
