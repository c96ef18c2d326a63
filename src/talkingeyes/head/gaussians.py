"""3D Gaussians bound to the triangles of a head: GaussianAvatars' `point_cloud.ply`, and their pose on a posed mesh.

Qian et al., "GaussianAvatars: Photorealistic head avatars with rigged 3D Gaussians" (CVPR 2024), section 3.2: a
Gaussian lives in the frame of its triangle (origin: its centre; axes: the first edge, the normal, the product of both)
and scales with it (the mean of the first edge and of the height on it). The file is that of 3D Gaussian splatting
(Kerbl et al. 2023): one element `vertex` of float32, little endian, with x, y, z; f_dc_0 to 2 and f_rest_0, ...
(spherical harmonics, a channel after the other); opacity (logit); scale_0 to 2 (logarithms); rot_0 to 3 (w, x, y, z);
and binding_0, the index of the triangle. View directions of the harmonics are those of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_bytes, reading
from talkingeyes.core.errors import InputError

MAX_GAUSSIANS, MAX_FILE_BYTES, MAX_HEADER_BYTES = 1_000_000, 2**28, 2**14
TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4"}
TYPES |= {"float": "<f4", "float32": "<f4", "double": "<f8", "int32": "<i4", "uint8": "u1"}
REST_COUNTS = {0: 0, 9: 1, 24: 2, 45: 3}  # f_rest properties: degree of the spherical harmonics
BINDING = "binding_0"
MAX_LOG_SCALE = 20.0


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians in any frame: `harmonics` are K = (degree + 1)^2 coefficients of colour (sRGB - 0.5).

    `means` and `scales` (standard deviations) are in metres or in units of a triangle, `rotations` map the axes of a
    Gaussian to that frame, `opacities` are 0 to 1.
    """

    means: Float[ndarray, "N 3"]
    scales: Float[ndarray, "N 3"]
    rotations: Float[ndarray, "N 3 3"]
    opacities: Float[ndarray, " N"]
    harmonics: Float[ndarray, "N K 3"]

    def __len__(self) -> int:
        return len(self.means)

    def of(self, chosen: ndarray) -> Gaussians:
        """Some of the Gaussians, by index or mask."""
        return Gaussians(
            self.means[chosen],
            self.scales[chosen],
            self.rotations[chosen],
            self.opacities[chosen],
            self.harmonics[chosen],
        )


@dataclass(frozen=True)
class BoundGaussians:
    """Gaussians in the frames of triangles, the triangle of each, and the comments of the file."""

    local: Gaussians
    binding: Int[ndarray, " N"]
    comments: tuple[str, ...] = ()

    def posed(self, vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Gaussians:
        """The Gaussians on a posed mesh, in single precision."""
        centres, axes, sizes = triangle_frames(vertices, faces)
        centre, axis, size = centres[self.binding], axes[self.binding], sizes[self.binding][:, None]
        local = self.local
        means = (axis @ local.means[..., None])[..., 0] * size + centre
        return Gaussians(means, local.scales * size, axis @ local.rotations, local.opacities, local.harmonics)


def triangle_frames(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]
) -> tuple[Float[ndarray, "F 3"], Float[ndarray, "F 3 3"], Float[ndarray, " F"]]:
    """Centres, axes (columns) and sizes of triangles; those without an area have the size 0 of a point at most."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    edge, across = second - first, third - first
    length = np.linalg.norm(edge, axis=1)
    along = edge / np.maximum(length, 1e-20)[:, None]
    normal = np.cross(along, across)
    height = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(height, 1e-20)[:, None]
    axes = np.stack([along, normal, np.cross(along, normal)], axis=-1)
    return (first + second + third) / 3, axes, (length + height) / 2


def read_gaussians(path: Path) -> BoundGaussians:
    """Read a `point_cloud.ply` of GaussianAvatars. Raises InputError (one line) for other and damaged files."""
    with reading(path, "point cloud of Gaussians"):
        content = read_bytes(path, MAX_FILE_BYTES)
        rows, comments = _rows(content)
        names = rows.dtype.names or ()
        missing = [name for name in (*_names(0), BINDING) if name not in names]
        if missing:
            raise ValueError(f"should have the properties of Gaussians bound to triangles, lacks {', '.join(missing)}")
        rest = sum(name.startswith("f_rest_") for name in names)
        if rest not in REST_COUNTS or any(f"f_rest_{k}" not in names for k in range(rest)):
            raise ValueError(f"should have 0, 9, 24 or 45 properties f_rest_, got {rest}")
        columns = np.stack([rows[name].astype(np.float32) for name in (*_names(rest), BINDING)], axis=1)
    if not np.isfinite(columns).all():
        raise InputError(f"{path}: holds NaN or infinite values")
    means, dc, others, opacity, scale, turn, binding = np.split(columns, np.cumsum([3, 3, rest, 1, 3, 4]), axis=1)
    if scale.size and scale.max() > MAX_LOG_SCALE:
        raise InputError(f"{path}: scales should be logarithms below {MAX_LOG_SCALE:g}, got {scale.max():g}")
    if binding.size and (binding.min() < 0 or (binding % 1).any()):
        raise InputError(f"{path}: binding_0 should be indices of triangles, got {binding.min():g}")
    harmonics = np.concatenate([dc[:, None], others.reshape(len(dc), 3, rest // 3).swapaxes(1, 2)], axis=1)
    local = Gaussians(
        means, np.exp(scale), _matrices(turn), 1 / (1 + np.exp(-np.clip(opacity[:, 0], -80, 80))), harmonics
    )
    return BoundGaussians(local, binding[:, 0].astype(np.int64), comments)


def write_gaussians(
    path: Path, gaussians: Gaussians, binding: Int[ndarray, " N"] | None = None, comments: tuple[str, ...] = ()
) -> None:
    """Write Gaussians atomically: with `binding` as GaussianAvatars does, else as 3D Gaussian splatting does."""
    from scipy.spatial.transform import Rotation

    count, rest = len(gaussians), 3 * (gaussians.harmonics.shape[1] - 1)
    names = [*_names(rest)[:3], "nx", "ny", "nz", *_names(rest)[3:], *([BINDING] if binding is not None else [])]
    clipped = np.clip(gaussians.opacities, 1e-6, 1 - 1e-6)
    turns = Rotation.from_matrix(gaussians.rotations).as_quat(scalar_first=True)
    table = [
        gaussians.means,
        np.zeros((count, 3)),
        gaussians.harmonics[:, 0],
        gaussians.harmonics[:, 1:].swapaxes(1, 2).reshape(count, rest),
        np.log(clipped / (1 - clipped))[:, None],
        np.log(np.maximum(gaussians.scales, 1e-12)),
        turns,
        *([binding[:, None]] if binding is not None else []),
    ]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {count}", *(f"property float {name}" for name in names), "end_header", ""]
    with atomic_write(path) as partial:
        partial.write_bytes("\n".join(lines).encode("ascii") + np.concatenate(table, axis=1).astype("<f4").tobytes())


def _names(rest: int) -> tuple[str, ...]:
    """The properties of a Gaussian, in the order of the file, without its normal and binding."""
    numbered = (("f_dc", 3), ("f_rest", rest), ("scale", 3), ("rot", 4))
    dc, others, scale, turn = ([f"{name}_{k}" for k in range(count)] for name, count in numbered)
    return ("x", "y", "z", *dc, *others, "opacity", *scale, *turn)


def _rows(content: bytes) -> tuple[ndarray, tuple[str, ...]]:
    """The table of a binary ply with one element, and its comments. Raises ValueError."""
    head, end, _ = content[:MAX_HEADER_BYTES].partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii").splitlines()]
    if not end or lines[0] != ["ply"] or lines[1][:2] != ["format", "binary_little_endian"]:
        raise ValueError("should be a binary little endian ply")
    elements = [line for line in lines if line[:1] == ["element"]]
    if [element[1] for element in elements] != ["vertex"]:
        raise ValueError("should have one element, vertex")
    count = int(elements[0][2])
    fields = [(line[-1], TYPES.get(line[1], "")) for line in lines if line[:1] == ["property"]]
    if any(not kind for _, kind in fields):
        raise ValueError("properties of a vertex should be numbers")
    dtype = np.dtype(fields)
    start = len(head) + len(end)
    if not 0 <= count <= MAX_GAUSSIANS or count * dtype.itemsize > len(content) - start:
        raise ValueError(f"claims {count:,} Gaussians of {dtype.itemsize} bytes, got {len(content) - start:,} bytes")
    comments = tuple(" ".join(line[1:]) for line in lines if line[:1] == ["comment"])
    return np.frombuffer(content, dtype, count, start), comments


def _matrices(quaternions: Float[ndarray, "N 4"]) -> Float[ndarray, "N 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z) of any length; 0 is no rotation."""
    from scipy.spatial.transform import Rotation

    none = np.linalg.norm(quaternions, axis=1, keepdims=True) < 1e-12
    safe = np.where(none, np.array([1.0, 0, 0, 0]), quaternions)
    return np.asarray(Rotation.from_quat(safe, scalar_first=True).as_matrix(), dtype=np.float32)
