"""FLAME parameters as npz: our own layout, VHAP's (which GaussianAvatars plays), DiffPoseTalk's.

The neck joint rotates the head, so `neck_pose` is the head's rotation and `rotation` is 0; the pivot is then the same
as here. FLAME has no lids: their closure is stored as `eyelids`, which players ignore. In VHAP's layout the expression
can move them too, and `eyelid_expr` says by how much, so that a reader can take it off again. Where a layout has no
eyes (DiffPoseTalk), they are stored additionally. Numbers are float32; texts state units, eye order, head model and
what the forward axes of the eyes are (`forward_axis`: `visual` or `optical`, animation/line_of_sight.py).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import CONVENTIONS, Motion
from talkingeyes.core.npz import save_npz
from talkingeyes.formats.readers.flame_parameters import EXPRESSION, LID_EXPRESSION
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY
from talkingeyes.head.model import HeadModel
from talkingeyes.head.retarget import lid_expression

SHAPE_COUNT, EXPRESSION_COUNT, VHAP_VERTICES = 300, 100, 5143  # FLAME's components; VHAP's mesh, which has teeth
METADATA = {name: CONVENTIONS[name] for name in ("axes", "units", "rotations", "eye_order")} | {"head_model": "flame"}


def write_flame(motion: Motion, path: Path, eyes: str) -> None:
    """global_orient, neck_pose, jaw_pose, leye_pose, reye_pose, expression (100), betas (300), transl, eyelids, fps."""
    _save(
        path,
        motion,
        eyes,
        {
            "global_orient": np.zeros((len(motion), 3)),
            "neck_pose": motion.head,
            "jaw_pose": motion.jaw,
            "leye_pose": motion.gaze[:, 0],
            "reye_pose": motion.gaze[:, 1],
            "expression": expression_components(motion, EXPRESSION_COUNT),
            "betas": np.zeros((1, SHAPE_COUNT)),
            "transl": motion.translation,
            "eyelids": motion.lid,
        },
    )


def write_vhap(motion: Motion, path: Path, eyes: str, head: HeadModel | None = None) -> None:
    """The names of VHAP's `tracked_flame_params`: one row per frame, one identity for all.

    With FLAME as `head`, `expr` moves the lids as its lid shapes would.
    """
    expression = expression_components(motion, EXPRESSION_COUNT)
    lids = {} if head is None else {LID_EXPRESSION: lid_expression(head, motion.gaze, motion.lid)}
    _save(
        path,
        motion,
        eyes,
        {
            "rotation": np.zeros((len(motion), 3)),
            "neck_pose": motion.head,
            "jaw_pose": motion.jaw,
            "eyes_pose": motion.gaze.reshape(-1, 6),
            "expr": expression + sum(lids.values()),
            **lids,
            "shape": np.zeros(SHAPE_COUNT),
            "translation": motion.translation,
            "static_offset": np.zeros((1, VHAP_VERTICES, 3)),
            "eyelids": motion.lid,
        },
        timestep_id=np.arange(len(motion)),
    )


def write_diffposetalk(motion: Motion, path: Path, eyes: str) -> None:
    """shape (100), exp (T, 50), pose (T, 6: head and jaw)."""
    _save(
        path,
        motion,
        eyes,
        {
            "shape": np.zeros(100),
            "exp": expression_components(motion, 50),
            "pose": np.concatenate([motion.head, motion.jaw], axis=1),
            "eyes_pose": motion.gaze.reshape(-1, 6),
            "eyelids": motion.lid,
            "transl": motion.translation,
        },
    )


def expression_components(motion: Motion, count: int) -> ndarray:
    """Weights of FLAME's first expression components, by the names of the motion's expression."""
    table = np.zeros((len(motion), count))
    for number in range(count):
        if EXPRESSION.format(number) in motion.expression_names:
            table[:, number] = motion.expression[:, motion.expression_names.index(EXPRESSION.format(number))]
    return table


def _save(path: Path, motion: Motion, eyes: str, arrays: dict[str, ndarray], **others: ndarray) -> None:
    numbers = {name: array.astype(np.float32) for name, array in arrays.items()}
    texts = {name: np.str_(text) for name, text in {**METADATA, FORWARD_AXIS_KEY: eyes}.items()}
    with atomic_write(path) as partial:
        save_npz(partial, fps=np.float64(motion.fps), **numbers, **others, **texts)
