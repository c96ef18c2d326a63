"""Head and poses for a browser: the head once as GLB, then a row of numbers per frame.

A row holds the translation of the root (3), quaternions x, y, z, w of neck, jaw, left eye, right eye (16), and the
weights of the morph targets in the order of the GLB: the values that `assets/stage.js` applies to the head. Float32,
little-endian.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.atomic_file import temporary_folder
from talkingeyes.core.motion import Motion
from talkingeyes.formats.rotations import quaternions
from talkingeyes.formats.writers.glb import joint_offsets, write_glb
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose

POSE_COLUMNS = 3 + 4 * 4  # columns before the weights


def head_glb(head: HeadModel) -> bytes:
    """The head at rest, with its joints and morph targets."""
    with temporary_folder() as folder:
        path = folder / "head.glb"
        write_glb(Motion.of(25.0, np.zeros((1, 3)), np.zeros((1, 2, 3))), head, path)
        return path.read_bytes()


def pose_rows(head: HeadModel, motion: Motion) -> Float[ndarray, "T C"]:
    """A motion as rows, with the columns of the module's docstring."""
    pose = motion_to_pose(head, motion)
    turned = (pose.head, pose.jaw, pose.gaze[:, 0], pose.gaze[:, 1])
    root = joint_offsets(head)[0] + pose.translation
    return np.concatenate([root, *map(quaternions, turned), pose.expression], axis=1).astype("<f4")
