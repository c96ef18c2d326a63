"""Face identity of a clip: weights of the head's identity shapes, and offsets of single landmarks.

Fitting the mean head to the landmarks of another face biases the head rotation (a long nose appears as a head turned
down), and with it gaze. The resting face is linear in the weights w and in the offsets d of the rigid landmarks. Each
round therefore linearises the observations of a sample of frames in their poses, w and d, eliminates the poses, and
solves for all frames at once

    minimise    sum |r - J_w w - J_d d|^2 / noise^2  +  |w|^2 / weight_sd^2  +  |d|^2 / offset_sd^2,  |w| <= max_weight

a linear least squares problem with bounds. The offsets represent what six shapes cannot, and detectors whose landmark
definitions differ from ours: MediaPipe's outline is up to 12 mm from the head's. One camera cannot distinguish a large
head from a near one, so the eyes fix the scale: the midpoints of the eye corners have no offsets, and the eyes stay
where the mean head has them (`head.landmarks`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from pydantic import Field
from scipy.optimize import lsq_linear

from talkingeyes.core.settings import Settings
from talkingeyes.fitting.head_pose import (
    HeadPoseSettings,
    pose_jacobian,
    pose_residual,
    projection_jacobian,
    solve_poses,
)
from talkingeyes.head.anny import anny_head
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmark_definitions import EYE_LANDMARKS
from talkingeyes.head.landmarks import RIGID_LANDMARKS, rest_landmarks

Positive = Annotated[float, Field(gt=0)]
CORNERS = EYE_LANDMARKS[:, [0, 3]]  # outer, inner
DERIVATIVE_STEP = 1e-3  # of a weight, for the derivative of the resting face


class FaceIdentitySettings(Settings):
    """`frames` of a clip that are used, `iterations` of linearisation, noise of the slow part of landmark errors.

    `weight_sd`, `max_weight`: of the weights of identity shapes; `offset_sd_m`: of the offsets of rigid landmarks.
    """

    frames: Annotated[int, Field(ge=1)]
    iterations: Annotated[int, Field(ge=0)]
    noise_px: Positive
    weight_sd: Positive
    max_weight: Positive
    offset_sd_m: Positive


@dataclass(frozen=True)
class FaceIdentity:
    """Landmarks of the resting face in head coordinates, and the weights of the identity shapes."""

    face: Float[ndarray, "L 3"]
    identity: Float[ndarray, " I"]


@cache
def identity_slopes() -> Float[ndarray, "I L 3"]:
    """Derivative of the resting landmarks by the weight of each identity shape."""
    weights = DERIVATIVE_STEP * np.eye(len(anny_head().identity_names))
    slopes = [rest_landmarks(tuple(row)) - rest_landmarks(tuple(-row)) for row in weights]
    return np.stack(slopes) / (2 * DERIVATIVE_STEP)


def face_identity(
    observed: Float[ndarray, "T L 2"], camera: Camera, pose_settings: HeadPoseSettings, settings: FaceIdentitySettings
) -> FaceIdentity:
    """Fit the identity of a clip; the mean head if no frame shows all rigid landmarks and eye corners."""
    slopes = identity_slopes()
    weights, offsets = np.zeros(len(slopes)), np.zeros((len(RIGID_LANDMARKS), 3))
    points = _stable(observed)
    rows = _chosen(np.isfinite(points).all(axis=(1, 2)), settings.frames)
    for _ in range(settings.iterations if len(rows) else 0):
        rest = _stable(rest_landmarks() + np.tensordot(weights, slopes, axes=1))
        rest[: len(RIGID_LANDMARKS)] += offsets
        change = _solved(
            points[rows], rest, np.concatenate([weights, offsets.ravel()]), camera, pose_settings, settings
        )
        weights, offsets = change[: len(slopes)], change[len(slopes) :].reshape(-1, 3)
    face = rest_landmarks() + np.tensordot(weights, slopes, axes=1)
    face[RIGID_LANDMARKS] += offsets
    return FaceIdentity(face, weights)


def _solved(
    points: Float[ndarray, "F K 2"],
    rest: Float[ndarray, "K 3"],
    state: Float[ndarray, " U"],
    camera: Camera,
    pose_settings: HeadPoseSettings,
    settings: FaceIdentitySettings,
) -> Float[ndarray, " U"]:
    """One round: new weights and offsets from those in `state` and the poses fitted under them."""
    slopes = identity_slopes()
    frames, visible = len(points), np.ones(points.shape[:2], bool)
    turn, translation = solve_poses(points, visible, camera, pose_settings, rest)
    residual = pose_residual(turn, translation, points, visible, camera, rest).reshape(frames, -1, 1)
    placed = np.einsum("tij,kj->tki", turn, rest) + translation[:, None]
    by_point = projection_jacobian(placed, camera) @ turn[:, None]
    by_weight = np.einsum("fkcd,ikd->fkci", by_point, np.stack([_stable(slope) for slope in slopes]))
    by_offset = np.zeros((*by_point.shape[:3], len(RIGID_LANDMARKS), 3))
    for point in range(len(RIGID_LANDMARKS)):
        by_offset[:, point, :, point] = by_point[:, point]
    unknown = np.concatenate([by_weight, by_offset.reshape(*by_offset.shape[:3], -1)], axis=-1)
    unknown = unknown.reshape(frames, -1, len(state))
    by_pose = pose_jacobian(turn, translation, camera, rest).reshape(frames, -1, 6)
    without_pose = np.eye(by_pose.shape[1]) - by_pose @ np.linalg.pinv(by_pose)
    unknown, residual = without_pose @ unknown, without_pose @ residual
    # the noise is slow, so many frames carry no more information than one
    noise_px = settings.noise_px * np.sqrt(frames)
    matrix = unknown.reshape(-1, len(state)) / noise_px
    target = matrix @ state - residual.ravel() / noise_px
    bound = np.concatenate([np.full(len(slopes), settings.max_weight), np.full(len(state) - len(slopes), np.inf)])
    prior = 1.0 / np.concatenate(
        [np.full(len(slopes), settings.weight_sd), np.full(len(state) - len(slopes), settings.offset_sd_m)]
    )
    normal = matrix.T @ matrix + np.diag(prior**2)  # of the stacked rows, reduced to a square matrix
    root = np.linalg.cholesky(normal).T
    return np.asarray(lsq_linear(root, np.linalg.solve(root.T, matrix.T @ target), (-bound, bound)).x)


def _stable(points: Float[ndarray, "*T L C"]) -> Float[ndarray, "*T K C"]:
    """The rigid landmarks, and the midpoints of the corners of each eye."""
    middles = points[..., CORNERS, :].mean(axis=-2)
    return np.concatenate([points[..., RIGID_LANDMARKS, :], middles], axis=-2)


def _chosen(usable: Bool[ndarray, " T"], most: int) -> Int[ndarray, " F"]:
    """Indices of at most `most` usable frames, spread over the clip."""
    found = np.flatnonzero(usable)
    return found[np.linspace(0, len(found) - 1, min(most, len(found))).round().astype(int)] if len(found) else found
