"""Positions of landmarks and pupils of the open head for given eyes, lids and jaw, as seen by a camera.

Only the landmarks are computed, from their rows of the blend shapes, not the whole mesh: the head's 62 shapes on 45
points. All landmarks are fixed to the skull (motion of neck skin is ignored), so `head_to_scene` transforms them
rigidly. Head coordinates are in metres: the origin is the head joint, between the ears; +x to the subject's left, y up,
+z out of the face. Eyes: left, right.

People differ by the weights of the head's identity shapes. Every face is scaled and shifted to the eyes of the mean
face, because one camera cannot distinguish a large head from a near one. All faces therefore have the same eye
distance, eyes and pupils.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import rotvec_to_direction, rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyeball import APEX_M
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS, LANDMARK_NAMES
from talkingeyes.head.posing import shape_weights

# a test compares them with the head
EYE_CENTRES = np.array([[0.0315, 0.041374, 0.084397], [-0.0315, 0.041374, 0.084397]])
PUPIL_OFFSET_M = APEX_M  # from the eye's centre to the pupil, along the optical axis

# Indices into LANDMARK_NAMES of the points that lids and brows do not move, and the jaw by less than a millimetre.
RIGID_LANDMARKS = np.array(
    [
        LANDMARK_NAMES.index(name)
        for name in LANDMARK_NAMES
        if name.endswith(("nose_wing", "temple", "outline_ear", "lobe")) or name.startswith("nose_")
    ]
)


@dataclass(frozen=True)
class LandmarkBasis:
    """LANDMARK_NAMES on the template, and their displacements by each shape of the head."""

    rest: Float[ndarray, "L 3"]
    shapes: Float[ndarray, "E L 3"]


@cache
def landmark_basis() -> LandmarkBasis:
    """The rows of the open head for its landmarks."""
    head = anny_head()
    return LandmarkBasis(head.landmarks.of(head.template), head.landmarks.of(head.expression))


def rest_landmarks(identity: Sequence[float] = ()) -> Float[ndarray, "L 3"]:
    """All LANDMARK_NAMES of a resting face: gaze ahead, lids open, mouth closed; of the mean face without weights.

    `identity`: weights of the head's identity shapes, around 0. Raises InputError if their number is wrong.
    """
    return _rest_points(tuple(identity))


@cache
def _rest_points(identity: tuple[float, ...]) -> Float[ndarray, "L 3"]:
    mean = landmark_basis().rest
    if not any(identity):
        return mean
    head = anny_head()
    if len(identity) != len(head.identity):
        raise InputError(f"identity: should be {len(head.identity)} weights, got {len(identity)}")
    weights = np.array(identity)
    points = mean + np.tensordot(weights, head.landmarks.of(head.identity), axes=1)
    centres = EYE_CENTRES + np.tensordot(weights, head.identity_joints[:, 3:], axes=1)
    scale = (EYE_CENTRES[0, 0] - EYE_CENTRES[1, 0]) / (centres[0, 0] - centres[1, 0])
    return np.asarray(EYE_CENTRES.mean(axis=0) + scale * (points - centres.mean(axis=0)))


def landmarks(
    gaze: Float[ndarray, "T 2 3"],
    lid: Float[ndarray, "T 2"],
    jaw: Float[ndarray, "T 3"],
    expression: Mapping[str, Float[ndarray, " T"]] = MappingProxyType({}),
    identity: Sequence[float] = (),
) -> Float[ndarray, "T L 3"]:
    """All LANDMARK_NAMES in head coordinates, metres. `expression`: weights of the head's shapes, by name."""
    return _moved(gaze, lid, jaw, np.arange(len(LANDMARK_NAMES)), expression, identity)


def motion_landmarks(motion: Motion, identity: Sequence[float] = ()) -> Float[ndarray, "T L 3"]:
    """All LANDMARK_NAMES in head coordinates for a motion of the open head, including its expression."""
    used = np.flatnonzero(np.abs(motion.expression).sum(axis=0))
    shown = {motion.expression_names[column]: motion.expression[:, column] for column in used}
    return landmarks(motion.gaze, motion.lid, motion.jaw, shown, identity)


def eye_landmarks(gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2 6 3"]:
    """Corners and lid points p1 to p6 of both eyes at a gaze and a closure."""
    points = _moved(gaze, lid, np.zeros((len(gaze), 3)), EYE_LANDMARKS.ravel(), {}, ())
    return points.reshape(len(gaze), 2, 6, 3)


def pupil_centres(gaze: Float[ndarray, "T 2 3"]) -> Float[ndarray, "T 2 3"]:
    """Pupil centres in head coordinates, metres."""
    return np.asarray(EYE_CENTRES + PUPIL_OFFSET_M * rotvec_to_direction(gaze))


def head_to_scene(
    points: Float[ndarray, "T K 3"], head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"]
) -> Float[ndarray, "T K 3"]:
    """Transform points from head to scene coordinates (rotation about the joint, translation) for `Camera.project`."""
    return np.asarray(np.einsum("tij,tkj->tki", rotvec_to_matrix(head), points) + translation[:, None])


def _moved(
    gaze: Float[ndarray, "T 2 3"],
    lid: Float[ndarray, "T 2"],
    jaw: Float[ndarray, "T 3"],
    wanted: ndarray,
    expression: Mapping[str, Float[ndarray, " T"]],
    identity: Sequence[float],
) -> Float[ndarray, "T K 3"]:
    head = anny_head()
    columns = [*shape_weights(head, gaze, lid, jaw).items(), *expression.items()]
    used = [head.shape(name) for name, _ in columns]
    shapes = landmark_basis().shapes[used][:, wanted].reshape(len(used), -1)
    moved = np.stack([column for _, column in columns], axis=-1) @ shapes
    return np.asarray(rest_landmarks(identity)[wanted] + moved.reshape(len(gaze), len(wanted), 3))
