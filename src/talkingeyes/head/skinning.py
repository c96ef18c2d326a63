"""Posing a head: blend shapes, then linear blend skinning over five joints.

    v = LBS(template + identity + expression + correctives (R - I), joints, weights)    FLAME (Li et al. 2017), eq. 2

`head` rotates the neck joint; the root, and with it the base of the neck, stays fixed. `translation` moves everything.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.model import PARENTS, HeadModel
from talkingeyes.head.posing import Pose


def posed_vertices(model: HeadModel, pose: Pose) -> Float[ndarray, "T V 3"]:
    """Vertices of poses, in single precision."""
    frames, root = len(pose.head), np.zeros((len(pose.head), 1, 3))
    vectors = np.concatenate([root, pose.head[:, None], pose.jaw[:, None], pose.gaze], axis=1)
    rotations = rotvec_to_matrix(vectors).astype(np.float32)
    rest = model.template + _shaped(pose.expression, model.expression)
    if len(model.correctives):
        rest += _shaped((rotations[:, 1:] - np.eye(3, dtype=np.float32)).reshape(frames, -1), model.correctives)
    # A row per entry of the transforms and a column per vertex: products of small matrices are slow in numpy.
    transforms = _joint_transforms(model, rotations).reshape(frames, len(PARENTS), 12).swapaxes(1, 2)
    blend = (transforms @ model.weights.T.astype(np.float32)).reshape(frames, 3, 4, -1)
    x, y, z = np.moveaxis(rest, 2, 0)[:, :, None]
    moved = blend[:, :, 0] * x + blend[:, :, 1] * y + blend[:, :, 2] * z + blend[:, :, 3]
    return np.ascontiguousarray((moved + pose.translation[..., None].astype(np.float32)).swapaxes(1, 2))


def _shaped(amounts: Float[ndarray, "T K"], shapes: Float[ndarray, "K V 3"]) -> Float[ndarray, "T V 3"]:
    """Weighted sums of shapes."""
    moved = amounts.astype(np.float32) @ shapes.reshape(len(shapes), -1).astype(np.float32)
    return np.asarray(moved.reshape(len(amounts), *shapes.shape[1:]))


def _joint_transforms(model: HeadModel, rotations: Float[ndarray, "T 5 3 3"]) -> Float[ndarray, "T 5 3 4"]:
    """Rotation and shift of what each joint carries."""
    joints = model.joints.astype(np.float32)
    turned, moved = [rotations[:, 0]], [np.broadcast_to(joints[0], (len(rotations), 3))]
    for joint, parent in list(enumerate(PARENTS))[1:]:
        moved.append(moved[parent] + turned[parent] @ (joints[joint] - joints[parent]))
        turned.append(turned[parent] @ rotations[:, joint])
    turn = np.stack(turned, axis=1)
    shift = np.stack(moved, axis=1) - (turn @ joints[..., None])[..., 0]
    return np.concatenate([turn, shift[..., None]], axis=-1)
