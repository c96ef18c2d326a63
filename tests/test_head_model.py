"""Posing: blend shapes and skinning compared with a plain computation of each vertex, batches, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import rotvec_to_matrix
from talkingeyes.head.anny import anny_head
from talkingeyes.head.model import PARENTS
from talkingeyes.head.posing import Pose, motion_to_pose
from talkingeyes.head.skinning import posed_vertices


def random_pose(frames: int, seed: int = 0) -> Pose:
    rng = np.random.default_rng(seed)
    shapes = {"expression": (len(anny_head().expression_names),), "head": (3,), "jaw": (3,), "gaze": (2, 3)}
    shapes["translation"] = (3,)
    return Pose(**{name: rng.normal(0, 0.2, (frames, *shape)) for name, shape in shapes.items()})


def test_skinning_is_the_chain_of_its_joints() -> None:
    """Reference computation, vertex by vertex and joint by joint, with 4 x 4 matrices."""
    head, pose = anny_head(), random_pose(1)
    found = posed_vertices(head, pose)[0]
    rest = head.template + np.tensordot(pose.expression[0], head.expression, axes=1)
    turns = [
        np.eye(3),
        rotvec_to_matrix(pose.head[0]),
        rotvec_to_matrix(pose.jaw[0]),
        *rotvec_to_matrix(pose.gaze[0]),
    ]
    worlds: list[np.ndarray] = []
    for joint, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, :3] = turns[joint]
        local[:3, 3] = head.joints[joint] - turns[joint] @ head.joints[joint]
        worlds.append(local if parent < 0 else worlds[parent] @ local)
    for vertex in range(0, len(rest), 97):
        blend = sum(weight * world for weight, world in zip(head.weights[vertex], worlds, strict=True))
        expected = (blend @ np.append(rest[vertex], 1.0))[:3] + pose.translation[0]
        np.testing.assert_allclose(found[vertex], expected, atol=1e-6)


def test_identity_moves_eyes_and_joints_together() -> None:
    head = anny_head()
    np.testing.assert_allclose(head.identity[0, head.pupils], head.identity_joints[0, 3:], atol=2e-3)


def test_a_head_turns_about_the_neck_and_leaves_its_foot() -> None:
    head = anny_head()
    turned = posed_vertices(
        head, motion_to_pose(head, Motion.of(25.0, np.array([[0.0, 0.5, 0.0]]), np.zeros((1, 2, 3))))
    )[0]
    foot = head.template[:, 1] < head.template[:, 1].min() + 0.005
    assert np.abs(turned - head.template)[foot].max() < 0.012
    assert turned[head.pupils, 0].mean() > 0.03  # to the subject's left


def test_expression_of_another_head_is_refused() -> None:
    motion = Motion.of(
        25.0, np.zeros((1, 3)), np.zeros((1, 2, 3)), expression=np.ones((1, 1)), expression_names=("expression_000",)
    )
    with pytest.raises(InputError, match="expression should be of the head anny, got expression_000"):
        motion_to_pose(anny_head(), motion)


def test_inconsistent_model_is_an_error() -> None:
    with pytest.raises(InputError, match="head anny: joints should be finite"):
        replace(anny_head(), joints=np.full((5, 3), np.nan))
    with pytest.raises(InputError, match="head anny: faces should name vertices"):
        replace(anny_head(), faces=anny_head().faces + 10_000)
