"""Motion of one frame from a mesh of the open head, by trimesh: obj or ply, metres, vertices in the head's order."""

from __future__ import annotations

import io
from pathlib import Path

from talkingeyes.core.containers import MAX_TEXT_BYTES, read_bytes, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.vertices import read_vertices


def read_mesh(path: Path, fps: float | None = None) -> Motion:
    """Fit the motion of the open head. Raises InputError for other meshes."""
    import trimesh

    with reading(path, "mesh"):
        content = io.BytesIO(read_bytes(path, MAX_TEXT_BYTES))
        mesh = trimesh.load_mesh(
            content, path.suffix[1:].lower(), process=False, maintain_order=True, skip_materials=True
        )
        vertices = mesh.vertices.reshape(1, -1)
    if not len(vertices[0]):
        raise InputError(f"{path}: should hold triangles, got none")
    return read_vertices(path, vertices, fps)
