"""Vertices of the posed head, in the layout of VOCASET: an npy of (T, 3 V) float32, metres.

For FLAME, V is 5,023, in the order of its vertices; the origin is the neck joint. Head, gaze and lids are included,
unlike in VOCASET. The rate is the motion's (VOCASET's is 60, usually halved). The file is written in blocks, so memory
does not grow with the motion.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import Motion
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose

FRAMES = 64  # per block


def write_vertices(motion: Motion, head: HeadModel, path: Path) -> None:
    """Write one row per frame."""
    from talkingeyes.head.skinning import posed_vertices

    shape = (len(motion), 3 * len(head.template))
    with atomic_write(path) as partial:
        table = np.lib.format.open_memmap(partial, "w+", np.float32, shape)
        for start in range(0, len(motion), FRAMES):
            part = posed_vertices(head, motion_to_pose(head, motion.cut(start, min(start + FRAMES, len(motion)))))
            table[start : start + len(part)] = part.reshape(len(part), -1)
        table.flush()
