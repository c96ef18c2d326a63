"""Draws the pictures of docs/head.md: gaze and lids, looks, and poses of the open head.

Run     python docs/pictures/head.py [FOLDER]
Writes  head.png, head_looks.png, head_poses.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from talkingeyes.core.motion import Motion
from talkingeyes.head.looks import LOOKS, dressed_head
from talkingeyes.rendering.contact_sheet import eyes_sheet, static_motion
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS

SIZE_PX = 300
POSES_DEG = ((0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 35, 0), (18, -30, 0), (0, 0, -14))  # head: pitch, yaw, roll
JAWS_DEG, LEFT_LIDS = (0, 6, 14, 0, 0, 0), (0, 0, 0, 0, 0, 1)


def tiled(pictures: list[np.ndarray], columns: int, path: Path) -> None:
    rows = [np.concatenate(pictures[at : at + columns], axis=1) for at in range(0, len(pictures), columns)]
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)


def main() -> None:
    """All three pictures."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent
    Image.fromarray(eyes_sheet(dressed_head(), 1400)).save(folder / "head.png", optimize=True)
    views = [FRAMINGS[name].view(SIZE_PX, SIZE_PX) for name in ("head", "left")]
    heads = [dressed_head(name) for name in LOOKS]
    tiled(
        [next(HeadRenderer(head, view).draw(static_motion())) for head in heads for view in views],
        6,
        folder / "head_looks.png",
    )
    jaws, lids = np.zeros((6, 3)), np.zeros((6, 2))
    jaws[:, 0], lids[:, 0] = np.radians(JAWS_DEG), LEFT_LIDS
    posed = Motion.of(25.0, np.radians(POSES_DEG), np.zeros((6, 2, 3)), jaw=jaws, lid=lids)
    face = FRAMINGS["face"].view(SIZE_PX, SIZE_PX)
    tiled(list(HeadRenderer(dressed_head(), face).draw(posed)), 3, folder / "head_poses.png")


if __name__ == "__main__":
    main()
