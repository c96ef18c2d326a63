"""A Gaussian avatar: a folder with the Gaussians of GaussianAvatars, and the head whose triangles carry them.

The folder of an avatar of GaussianAvatars has `point_cloud.ply`, `flame_param.npz` (of which identity, `shape`, and
`static_offset` are read) and the user's FLAME file (one .pkl, which GaussianAvatars keeps elsewhere). An avatar of the
open head has the first alone, with the comment `head anny`. GaussianAvatars adds teeth to FLAME, 168 triangles after
FLAME's; this project does not, so the Gaussians on them are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from talkingeyes.core.containers import read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.head.anny import anny_head
from talkingeyes.head.flame import SHAPES, VERTICES, load_flame
from talkingeyes.head.gaussians import BoundGaussians, Gaussians, read_gaussians, write_gaussians
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose

POINT_CLOUD, PARAMETERS = "point_cloud.ply", "flame_param.npz"
OPEN_HEAD = "head anny"
TEETH_FACES = 168
BLOCK_FRAMES = 16


@dataclass(frozen=True)
class GaussianAvatar:
    """A head and the Gaussians on its triangles."""

    head: HeadModel
    bound: BoundGaussians

    def posed(self, motion: Motion) -> Iterator[Gaussians]:
        """The Gaussians of each frame of a motion, whose expression is in the shapes of the head."""
        from talkingeyes.head.skinning import posed_vertices

        for start in range(0, len(motion), BLOCK_FRAMES):
            part = motion.cut(start, start + BLOCK_FRAMES)
            for vertices in posed_vertices(self.head, motion_to_pose(self.head, part)):
                yield self.bound.posed(vertices, self.head.faces)


def load_avatar(folder: Path) -> GaussianAvatar:
    """Read an avatar. Raises InputError (one line)."""
    path = folder / POINT_CLOUD
    bound = read_gaussians(path)
    if OPEN_HEAD in bound.comments:
        head, teeth = anny_head(), 0
    else:
        head, teeth = _flame_head(folder), TEETH_FACES
    most = int(bound.binding.max(initial=0))
    if most >= len(head.faces) + teeth:
        raise InputError(
            f"{path}: binding_0 should be triangles of {head.name}, below {len(head.faces) + teeth}, got {most}"
        )
    kept = bound.binding < len(head.faces)
    return GaussianAvatar(head, replace(bound, local=bound.local.of(kept), binding=bound.binding[kept]))


def save_avatar(folder: Path, bound: BoundGaussians) -> None:
    """Write the Gaussians of an avatar of the open head into a folder."""
    write_gaussians(folder / POINT_CLOUD, bound.local, bound.binding, (OPEN_HEAD,))


def _flame_head(folder: Path) -> HeadModel:
    """FLAME in the shape of the avatar's person."""
    models = sorted(folder.glob("*.pkl"))
    if len(models) != 1:
        raise InputError(f"{folder}: should hold one FLAME file (.pkl) beside {POINT_CLOUD}, got {len(models)}")
    path = folder / PARAMETERS
    content = read_npz(path, {"shape", "static_offset"}, "FLAME parameters of an avatar")
    shape = _finite(path, "shape", content.get("shape", np.zeros(0)).reshape(-1))
    if len(shape) > SHAPES:
        raise InputError(f"{path}: shape should have at most {SHAPES} numbers, got {len(shape)}")
    offset = _finite(path, "static_offset", content.get("static_offset", np.zeros((VERTICES, 3))))
    if offset.size % 3 or offset.size < 3 * VERTICES:
        raise InputError(
            f"{path}: static_offset should be (1, V, 3) of at least {VERTICES} vertices, got {offset.shape}"
        )
    return load_flame(models[0], shape=shape, offset=offset.reshape(-1, 3)[:VERTICES])


def _finite(path: Path, name: str, array: ndarray) -> ndarray:
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(f"{path}: {name} should be finite numbers")
    return array.astype(np.float64)
