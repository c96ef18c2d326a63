"""Posing a head in torch, for gradients: the formulas of skinning.py, with identity shapes; batched.

`head` rotates the neck joint; the root, and with it the base of the neck, stays fixed. `translation` moves everything.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.head.model import PARENTS, HeadModel


def pose_vertices(
    model: HeadModel,
    expression: Float[Tensor, "B E"],
    head: Float[Tensor, "B 3"],
    jaw: Float[Tensor, "B 3"],
    gaze: Float[Tensor, "B 2 3"],
    translation: Float[Tensor, "B 3"],
    identity: Float[Tensor, "B I"] | None = None,
) -> Float[Tensor, "B V 3"]:
    """Vertices of poses; `expression` are weights of all shapes, including lids and jaw (`posing.motion_to_pose`)."""
    joint_rotations = rotation_matrices(
        torch.cat([torch.zeros_like(head)[:, None], head[:, None], jaw[:, None], gaze], dim=1)
    )
    rest = add_blend_shapes(_tensor(model.template, head), _tensor(model.expression, head), expression)
    joints = _tensor(model.joints, head).expand(len(head), 5, 3)
    if identity is not None:
        rest = add_blend_shapes(rest, _tensor(model.identity, head), identity)
        joints = add_blend_shapes(joints, _tensor(model.identity_joints, head), identity)
    if len(model.correctives):
        bent = (joint_rotations[:, 1:] - torch.eye(3, dtype=head.dtype, device=head.device)).flatten(1)
        rest = add_blend_shapes(rest, _tensor(model.correctives, head), bent)
    return linear_blend_skinning(rest, joints, joint_rotations, _tensor(model.weights, head)) + translation[:, None]


def add_blend_shapes(
    rest: Float[Tensor, "*B V 3"], shapes: Float[Tensor, "K V 3"], amounts: Float[Tensor, "B K"]
) -> Float[Tensor, "B V 3"]:
    """Add weighted shapes to `rest`."""
    moved: Tensor = (amounts @ shapes.flatten(1)).unflatten(1, shapes.shape[1:])
    return rest + moved


def linear_blend_skinning(
    rest: Float[Tensor, "B V 3"],
    joints: Float[Tensor, "B 5 3"],
    joint_rotations: Float[Tensor, "B 5 3 3"],
    weights: Float[Tensor, "V 5"],
) -> Float[Tensor, "B V 3"]:
    """Linear blend skinning: transform each vertex by the weighted mean of its joints' transforms."""
    turned, moved = [joint_rotations[:, 0]], [joints[:, 0]]
    for joint, parent in list(enumerate(PARENTS))[1:]:
        offset = joints[:, joint] - joints[:, parent]
        moved.append(moved[parent] + (turned[parent] @ offset[..., None])[..., 0])
        turned.append(turned[parent] @ joint_rotations[:, joint])
    turn = torch.stack(turned, dim=1)
    shift = torch.stack(moved, dim=1) - (turn @ joints[..., None])[..., 0]
    blend = torch.einsum("vj,bjk->bvk", weights, torch.cat([turn.flatten(2), shift], dim=2))
    turned_vertices: Tensor = (blend[..., :9].unflatten(-1, (3, 3)) @ rest[..., None])[..., 0]
    return turned_vertices + blend[..., 9:]


def rotation_matrices(vectors: Float[Tensor, "*N 3"]) -> Float[Tensor, "*N 3 3"]:
    """Rotation vectors to matrices (Rodrigues), smooth at zero."""
    squared = vectors.square().sum(-1)[..., None, None].clamp_min(1e-12)
    angle = squared.sqrt()
    x, y, z = vectors.unbind(-1)
    none = torch.zeros_like(x)
    cross = torch.stack([none, -z, y, z, none, -x, -y, x, none], dim=-1).unflatten(-1, (3, 3))
    sine, versine = angle.sin() / angle, (1 - angle.cos()) / squared
    matrices: Tensor = torch.eye(3, dtype=vectors.dtype, device=vectors.device) + sine * cross
    second: Tensor = versine * (cross @ cross)
    return matrices + second


def _tensor(array: Float[ndarray, "*N"], like: Tensor) -> Tensor:
    """A model array with the precision and device of the pose; on the CPU without a copy."""
    return torch.from_numpy(array).to(like)
