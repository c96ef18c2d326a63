"""Motion from vertices of the open head in the layout of VOCASET (T, 3 V).

Skinning is linear in the shape weights once the head's rotation is known. The rotation follows from the vertices that
no shape moves (Kabsch 1976), those of the eyes from the vertices of the eyeballs. The effect of gaze on the lids is
subtracted. Face, jaw and blinks then follow by least squares over the vertices that are attached to the head alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.head.anny import anny_head
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES, eyelid_weights
from talkingeyes.head.model import JOINTS, HeadModel
from talkingeyes.head.posing import JAW_SHAPES, JAW_SIDE_RAD, SIDES

STATIC_VERTEX_M = 1e-7  # maximum shape offset of a static vertex
SINGLE_JOINT_WEIGHT = 0.9999  # skinning weight of a vertex that follows a single joint
MAX_FIT_ERROR_M = 1e-3  # maximum root mean square error of the fitted vertices
BLINK_SHAPES = tuple(f"lidBlink{side}" for side in SIDES)


def read_vertices(path: Path, table: Float[ndarray, "T C"], fps: float | None = None) -> Motion:
    """Fit the motion of the open head. Raises InputError for vertices of another head."""
    head = anny_head()
    if table.shape[1] != 3 * len(head.template):
        raise InputError(
            f"{path}: vertices should be those of the open head (T, {3 * len(head.template)}), got {table.shape}"
        )
    if fps is None:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps")
    points = table.reshape(len(table), -1, 3).astype(np.float64)
    still = np.abs(head.expression).max(axis=(0, 2)) < STATIC_VERTEX_M
    neck, *eyes = (_alone(head, joint) & still for joint in ("neck", "left_eye", "right_eye"))
    turned = _turn(head.template[neck], points[:, neck])
    shift = points[:, neck].mean(axis=1) - np.einsum("tij,j->ti", turned, head.template[neck].mean(axis=0))
    gaze = rotation.matrix_to_rotvec(
        np.stack([np.swapaxes(turned, 1, 2) @ _turn(head.template[eye], points[:, eye]) for eye in eyes], axis=1)
    )
    straight = np.einsum("tji,tvj->tvi", turned, points - shift[:, None])
    shown = _weights(path, head, gaze, straight)
    jaw = [head.jaw_open_rad * shown["jawOpen"], JAW_SIDE_RAD * (shown["jawLeft"] - shown["jawRight"])]
    whole = eyelid_weights(head, gaze, np.ones((len(points), 2)))
    return Motion.of(
        fps,
        rotation.matrix_to_rotvec(turned),
        gaze,
        translation=shift,
        lid=np.stack([shown[name] / np.maximum(whole[name], 1e-6) for name in BLINK_SHAPES], axis=1),
        jaw=np.stack([*jaw, np.zeros(len(points))], axis=1),
        expression=np.stack([shown[name] for name in arkit.EXPRESSION], axis=1),
        expression_names=arkit.EXPRESSION,
    )


def _alone(head: HeadModel, joint: str) -> Bool[ndarray, " V"]:
    return np.asarray(head.weights[:, JOINTS.index(joint)] > SINGLE_JOINT_WEIGHT)


def _turn(rest: Float[ndarray, "K 3"], moved: Float[ndarray, "T K 3"]) -> Float[ndarray, "T 3 3"]:
    """Rotations that align points (Kabsch)."""
    here, there = rest - rest.mean(axis=0), moved - moved.mean(axis=1, keepdims=True)
    left, _, right = np.linalg.svd(np.einsum("tki,kj->tij", there, here))
    left[..., -1] *= np.linalg.det(left @ right)[:, None]
    return np.asarray(left @ right)


def _weights(
    path: Path, head: HeadModel, gaze: Float[ndarray, "T 2 3"], straight: Float[ndarray, "T V 3"]
) -> dict[str, Float[ndarray, " T"]]:
    """Weights of expression, jaw and blinks, by name."""
    names = (*arkit.EXPRESSION, *JAW_SHAPES, *BLINK_SHAPES)
    part = _alone(head, "neck")
    opened = eyelid_weights(head, gaze, np.zeros((len(gaze), 2)))
    left = straight - head.template
    for name in LID_SHAPES:
        left = left - opened[name][:, None, None] * head.expression[head.shape(name)]
    basis = head.expression[[head.shape(name) for name in names]][:, part].reshape(len(names), -1).astype(np.float64)
    wanted = left[:, part].reshape(len(left), -1)
    found = np.linalg.solve(basis @ basis.T, basis @ wanted.T)
    missed = float(np.sqrt(3 * ((wanted - found.T @ basis) ** 2).mean()))
    if missed > MAX_FIT_ERROR_M:
        raise InputError(f"{path}: vertices should be those of the open head, got vertices {1e3 * missed:.1f} mm off")
    return dict(zip(names, found, strict=True))
