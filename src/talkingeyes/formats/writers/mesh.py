"""The posed head in one frame as a mesh, by trimesh: obj or ply, metres, with vertex colours (sRGB).

Vertices are those of `vertices` (VOCASET), in the same order; the origin is the neck joint.
"""

from __future__ import annotations

from pathlib import Path

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import Motion
from talkingeyes.head.model import HeadModel
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.rendering.shading import to_pixels


def write_mesh(motion: Motion, head: HeadModel, path: Path) -> None:
    """Write the first frame of a motion, in the format of the file's suffix."""
    from trimesh import Trimesh

    from talkingeyes.head.skinning import posed_vertices

    (vertices,) = posed_vertices(head, motion_to_pose(head, motion.cut(0, 1)))
    mesh = Trimesh(vertices, head.faces, vertex_colors=to_pixels(head.colours), process=False)
    with atomic_write(path) as partial:
        mesh.export(partial, path.suffix[1:].lower())
