"""The posed Gaussians of an avatar in one frame, as 3D Gaussian splatting writes them (ply): for public viewers.

These expect y down, as in the cameras of COLMAP, so that the frame is turned by 180 degrees about x. Metres.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from talkingeyes.core.motion import Motion
from talkingeyes.head.gaussian_avatar import GaussianAvatar
from talkingeyes.head.gaussians import Gaussians, write_gaussians

Y_DOWN = np.diag([1.0, -1.0, -1.0]).astype(np.float32)
# Of each spherical harmonic, in the order of the file: whether it keeps its sign in the turn.
SIGNS = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)


def write_posed_gaussians(motion: Motion, avatar: GaussianAvatar, path: Path) -> None:
    """Write the first frame of a motion."""
    write_gaussians(path, y_down(next(avatar.posed(motion.cut(0, 1)))))


def y_down(gaussians: Gaussians) -> Gaussians:
    """The Gaussians turned by 180 degrees about x, with their harmonics."""
    return replace(
        gaussians,
        means=gaussians.means @ Y_DOWN,
        rotations=Y_DOWN @ gaussians.rotations,
        harmonics=gaussians.harmonics * SIGNS[: gaussians.harmonics.shape[1], None],
    )
