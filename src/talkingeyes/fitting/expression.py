"""Jaw and expression of each frame: bounded linear least squares on the landmarks of brows, nose, mouth and outline.

With head pose and resting face known, the projected points are approximately linear in the weights b of the head's
ARKit blend shapes:

    minimise    |A_t b - r_t|^2 / noise^2  +  |b|^2 / weight_sd^2,     0 <= b <= 1

Six mouth landmarks cannot separate thirty shapes. The Gaussian prior distributes a displacement over the shapes that
explain it, so single weights mean little; only their combined effect on the landmarks is fitted. Frames are solved
together in blocks by coordinate descent with clipping to the bounds, so memory does not grow with the clip. Lids are
not among the shapes: they come from the eye aspect ratio (`blink`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.core.settings import Settings
from talkingeyes.fitting.head_pose import HeadPose, projection_jacobian
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS, LANDMARK_NAMES
from talkingeyes.head.landmarks import landmark_basis
from talkingeyes.head.posing import JAW_SIDE_RAD, expression_shape_names

Positive = Annotated[float, Field(gt=0)]
JAW = ("jawOpen", "jawLeft", "jawRight")
FITTED_LANDMARKS = np.setdiff1d(np.arange(len(LANDMARK_NAMES)), EYE_LANDMARKS)
LIPS = [LANDMARK_NAMES.index("upper_lip_inner"), LANDMARK_NAMES.index("lower_lip_inner")]
CLOSED_LIPS_PERCENTILE = 10  # of the gap between the lips: frames below it show the mouth at rest
BLOCK = 512  # frames


class ExpressionSettings(Settings):
    """`noise_px` of landmarks, `weight_sd` of the weights, `sweeps` of coordinate descent.

    `neutral_weight`: the fraction of the residual in frames with shut lips that is attributed to the resting face
    instead of expression. 0 suits landmarks defined as on the head model, 1 a detector with its own definition of the
    mouth.
    """

    noise_px: Positive
    weight_sd: Positive
    sweeps: Annotated[int, Field(gt=0)]
    neutral_weight: Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class FittedExpression:
    """Jaw as rotation vectors, and weights of the expression shapes of a Motion in the order of `names`."""

    jaw: Float[ndarray, "T 3"]
    expression: Float[ndarray, "T C"]
    names: tuple[str, ...]


@cache
def landmark_shapes() -> Float[ndarray, "E K 3"]:
    """Displacements of FITTED_LANDMARKS by the jaw shapes and by the expression shapes of a Motion."""
    head = anny_head()
    return np.asarray(
        landmark_basis().shapes[[head.shape(name) for name in (*JAW, *expression_shape_names(head))]][
            :, FITTED_LANDMARKS
        ]
    )


def fit_expression(
    observed: Float[ndarray, "T L 2"],
    pose: HeadPose,
    rest: Float[ndarray, "L 3"],
    camera: Camera,
    settings: ExpressionSettings,
) -> FittedExpression:
    """Fit jaw and expression under a head pose; hidden points are ignored, a frame without points is neutral."""
    names = expression_shape_names(anny_head())
    still = _own_rest(observed, pose, rest, camera, settings.neutral_weight)
    blocks = [slice(start, start + BLOCK) for start in range(0, len(observed), BLOCK)]
    weights = np.concatenate([_weights(observed[at], pose, at, still, camera, settings) for at in blocks])
    jaw = np.zeros((len(observed), 3))
    jaw[:, 0] = weights[:, 0] * anny_head().jaw_open_rad
    jaw[:, 1] = (weights[:, 1] - weights[:, 2]) * JAW_SIDE_RAD
    return FittedExpression(jaw, weights[:, len(JAW) :], names)


def _own_rest(
    observed: Float[ndarray, "T L 2"],
    pose: HeadPose,
    rest: Float[ndarray, "L 3"],
    camera: Camera,
    share: float,
) -> Float[ndarray, "K 3"]:
    """FITTED_LANDMARKS of the resting face, shifted in the face plane by their residual in frames with shut lips."""
    still = rest[FITTED_LANDMARKS]
    gap = np.linalg.norm(np.diff(observed[:, LIPS], axis=1)[:, 0], axis=-1)
    if not share or not np.isfinite(gap).any():
        return still
    shut = np.flatnonzero(gap <= np.nanpercentile(gap, CLOSED_LIPS_PERCENTILE))
    turn = rotvec_to_matrix(pose.head[shut])
    placed = np.einsum("tij,kj->tki", turn, still) + pose.translation[shut, None]
    away = np.nan_to_num(observed[shut][:, FITTED_LANDMARKS] - camera.project(placed))
    in_plane = (projection_jacobian(placed, camera) @ turn[:, None])[..., :2]
    moved = np.median(np.linalg.solve(in_plane, away[..., None])[..., 0], axis=0)
    return np.asarray(still + share * np.column_stack([moved, np.zeros(len(moved))]))


def _weights(
    observed: Float[ndarray, "F L 2"],
    pose: HeadPose,
    at: slice,
    still: Float[ndarray, "K 3"],
    camera: Camera,
    settings: ExpressionSettings,
) -> Float[ndarray, "F E"]:
    """Fit the weights of a block of frames."""
    turn = rotvec_to_matrix(pose.head[at])
    placed = np.einsum("tij,kj->tki", turn, still) + pose.translation[at, None]
    away = observed[:, FITTED_LANDMARKS] - camera.project(placed)
    known = np.isfinite(away)
    by_point = (projection_jacobian(placed, camera) @ turn[:, None]) * known[..., :1, None]
    frames, unknowns = len(away), len(landmark_shapes())
    matrix = np.einsum("tkcd,ekd->tkce", by_point, landmark_shapes(), optimize=True).reshape(frames, -1, unknowns)
    target = np.where(known, away, 0.0).reshape(frames, -1, 1)
    hessian = matrix.swapaxes(1, 2) @ matrix + (settings.noise_px / settings.weight_sd) ** 2 * np.eye(unknowns)
    return solve_bounded(hessian, (matrix.swapaxes(1, 2) @ target)[..., 0], settings.sweeps)


def solve_bounded(hessian: Float[ndarray, "F E E"], slope: Float[ndarray, "F E"], sweeps: int) -> Float[ndarray, "F E"]:
    """Minimise b'Hb / 2 - slope'b over b in [0, 1] for each frame, by `sweeps` of coordinate descent."""
    # frames last, so that each coordinate is one pass over memory
    rows = np.ascontiguousarray(hessian.transpose(1, 2, 0))
    gradient, found = -slope.T.copy(), np.zeros(slope.T.shape)
    for _ in range(sweeps):
        for index in range(len(found)):
            new = np.clip(found[index] - gradient[index] / rows[index, index], 0.0, 1.0)
            gradient += rows[index] * (new - found[index])
            found[index] = new
    return np.asarray(found.T)
