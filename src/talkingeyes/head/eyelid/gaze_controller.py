"""Geometric controller: from a target in space to the four angles of the two eyes.

Elisei, Bailly & Casari (AVSP 2007), section 5.2: a target in homogeneous coordinates (x, y, z, w) is the point (x, y,
z) / w, and for w = 0 the direction (x, y, z) at optical infinity. One formula covers both cases, and the eyes converge
on near targets. `animate --target` aims both lines of sight with it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import direction_to_angles, rotvec_to_matrix


def aim_eyes(
    target: Float[ndarray, "*N 4"],
    eyes: Float[ndarray, "2 3"],
    head: Float[ndarray, "*N 3"],
    translation: Float[ndarray, "*N 3"],
) -> Float[ndarray, "*N 2 2"]:
    """(yaw, pitch) in the head of the left and right eye that look at a target in space.

    `eyes` are their centres in head coordinates; a point p of the head is at R(head) p + translation in space. Both
    lines of sight meet at the target. Raises InputError for invalid targets.
    """
    if not np.isfinite(target).all():
        raise InputError(
            "target: should be four finite homogeneous coordinates, got NaN or infinite ones; w = 0 is far"
        )
    weight = target[..., 3:]
    sign = np.where(weight < 0, -1.0, 1.0)  # (-x, -w) is the same point as (x, w)
    moved = sign * (target[..., :3] - weight * translation)
    in_head = np.einsum("...ji,...j->...i", rotvec_to_matrix(head), moved)
    sight = in_head[..., None, :] - (sign * weight)[..., None, :] * eyes
    length = np.linalg.norm(sight, axis=-1, keepdims=True)
    if (length < 1e-9).any():
        raise InputError("target: should be a point outside the eyes or a direction, got the centre of an eye or zeros")
    return direction_to_angles(sight / length)


def homogeneous(points_m: Float[ndarray, "*N 3"]) -> Float[ndarray, "*N 4"]:
    """The homogeneous coordinates of points: w = 1."""
    return np.concatenate([points_m, np.ones((*np.shape(points_m)[:-1], 1))], axis=-1)
