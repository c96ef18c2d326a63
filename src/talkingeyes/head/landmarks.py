"""Where the named points and the pupils of the open head are when eyes, lids and jaw move: what a camera follows.

Only the points are reckoned, from their own rows of the blend shapes, not the whole mesh: the head's 62 shapes on 45
points. All hang on the skull (what skin of the neck does is left out), so `in_camera` turns and moves them as one.
Head coordinates, metres: the origin is the head joint, between the ears; +x to the subject's left, y up, +z out of the
face. Eyes: left, right.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.head.anny import open_head
from talkingeyes.head.drive import shape_weights
from talkingeyes.head.eyeball import APEX_M
from talkingeyes.head.face_points import EYES, NAMES
from talkingeyes.rotation import directions, matrices

EYE_CENTRES = np.array([[0.0315, 0.041374, 0.084397], [-0.0315, 0.041374, 0.084397]])  # a test holds the head to them
PUPIL_M = APEX_M  # from the eye's centre to the pupil, along the optical axis

RIGID = (
    np.array(  # indices into NAMES of the points that neither lids nor brows move, and the jaw by under a millimetre
        [
            NAMES.index(name)
            for name in NAMES
            if name.endswith(("nose_wing", "temple", "outline_ear", "lobe")) or name.startswith("nose_")
        ]
    )
)


@dataclass(frozen=True)
class FacePoints:
    """The points of NAMES on the template, and how far each shape of the head moves them."""

    rest: Float[ndarray, "L 3"]
    shapes: Float[ndarray, "E L 3"]


@cache
def face_points() -> FacePoints:
    """The rows of the open head that its landmarks need."""
    head = open_head()
    return FacePoints(head.landmarks.of(head.template), head.landmarks.of(head.expression))


def rest_points() -> Float[ndarray, "L 3"]:
    """All points of NAMES of the face that looks ahead, lids open, mouth shut."""
    return face_points().rest


def landmarks(
    gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"], jaw: Float[ndarray, "T 3"]
) -> Float[ndarray, "T L 3"]:
    """All points of NAMES in head coordinates, metres."""
    return _moved(gaze, lid, jaw, np.arange(len(NAMES)))


def eye_points(gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2 6 3"]:
    """Corners and lid points p1 to p6 of both eyes at a gaze and a closure."""
    points = _moved(gaze, lid, np.zeros((len(gaze), 3)), EYES.ravel())
    return points.reshape(len(gaze), 2, 6, 3)


def pupils(gaze: Float[ndarray, "T 2 3"]) -> Float[ndarray, "T 2 3"]:
    """Pupil centres in head coordinates, metres."""
    return np.asarray(EYE_CENTRES + PUPIL_M * directions(gaze))


def in_camera(
    points: Float[ndarray, "T K 3"], head: Float[ndarray, "T 3"], translation: Float[ndarray, "T 3"]
) -> Float[ndarray, "T K 3"]:
    """Points in head coordinates after the head has turned about its joint and moved; what `Camera.project` takes."""
    return np.asarray(np.einsum("tij,tkj->tki", matrices(head), points) + translation[:, None])


def _moved(
    gaze: Float[ndarray, "T 2 3"], lid: Float[ndarray, "T 2"], jaw: Float[ndarray, "T 3"], wanted: ndarray
) -> Float[ndarray, "T K 3"]:
    face = face_points()
    weights = shape_weights(open_head(), gaze, lid, jaw)
    used = [open_head().shape(name) for name in weights]
    moved = np.stack(list(weights.values()), axis=-1) @ face.shapes[used][:, wanted].reshape(len(used), -1)
    return np.asarray(face.rest[wanted] + moved.reshape(len(gaze), len(wanted), 3))
