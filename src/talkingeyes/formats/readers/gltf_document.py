"""A binary glTF 2.0 file: the numbers of its accessors, the keys of its first animation, its nodes at rest, the names
of its shapes.

Of an animation, channels without a node (extensions) are ignored, as the specification demands.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from talkingeyes.core.containers import MAX_ARRAY_BYTES, parse_json, read_bytes
from talkingeyes.core.errors import InputError
from talkingeyes.formats.shape_names import shape_names

FLOAT = 5126
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}  # what stands for 1 in normalised integers
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass(frozen=True)
class Track:
    """Keyframes of one node."""

    times_s: Float[ndarray, " K"]
    values: Float[ndarray, "K C"]

    def sampled(self, times: Float[ndarray, " T"]) -> Float[ndarray, "T C"]:
        """Values at times, linearly interpolated."""
        return np.stack([np.interp(times, self.times_s, column) for column in self.values.T], axis=1)

    def rotations(self, times: Float[ndarray, " T"]) -> Rotation:
        """Rotations at times, with spherical interpolation of quaternions."""
        keys = Rotation.from_quat(self.values)
        if len(self.times_s) == 1:
            return Rotation.concatenate([keys] * len(times))
        return Slerp(self.times_s, keys)(np.clip(times, self.times_s[0], self.times_s[-1]))


Tracks = dict[tuple[int, str], Track]


@dataclass(frozen=True)
class RestRotation:
    """The rotation of a node at rest: that of its parent in the file's axes, and its own in its parent.

    Rigs of other programs have bones with axes of their own, so a turn of the head about the file's axes is another
    rotation in the axes of the bone.
    """

    parent: Rotation
    own: Rotation

    def to_file_axes(self, local: Rotation) -> Rotation:
        """The turn from rest, about the file's axes, of a rotation of the node."""
        return self.parent * local * self.own.inv() * self.parent.inv()

    def from_file_axes(self, turn: Rotation) -> Rotation:
        """The inverse of `to_file_axes`."""
        return self.parent.inv() * turn * self.parent * self.own


@dataclass(frozen=True)
class GltfDocument:
    """The JSON of a file and its binary buffer."""

    path: Path
    content: dict[str, Any]
    binary: bytes

    def array(self, index: int) -> Float[ndarray, "N C"]:
        """Values of an accessor, dense or sparse; normalised integers are divided."""
        accessor = self.content["accessors"][index]
        kind, width = accessor["componentType"], WIDTHS[accessor["type"]]
        values = self._elements(accessor, kind, width, accessor["count"])
        if "sparse" in accessor:
            count, places = accessor["sparse"]["count"], accessor["sparse"]["indices"]
            rows = self._elements(places, places["componentType"], 1, count)[:, 0].astype(np.int64)
            values[rows] = self._elements(accessor["sparse"]["values"], kind, width, count)
        return np.maximum(values / LARGEST[kind], -1.0) if accessor.get("normalized") else values

    def _elements(self, place: dict[str, Any], kind: int, width: int, count: int) -> Float[ndarray, "N C"]:
        """Numbers in a buffer view; zeros where there is none."""
        if count * width * 8 > MAX_ARRAY_BYTES:
            raise InputError(f"{self.path}: accessors should have at most {MAX_ARRAY_BYTES:,} bytes")
        if "bufferView" not in place:
            return np.zeros((count, width))
        view, dtype = self.content["bufferViews"][place["bufferView"]], np.dtype(DTYPES[kind])
        if view.get("buffer", 0) != 0 or "uri" in self.content.get("buffers", [{}])[0] or view.get("extensions"):
            raise InputError(f"{self.path}: animation should be in the file's own buffer, uncompressed")
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        strides = (view.get("byteStride") or dtype.itemsize * width, dtype.itemsize)
        return np.ndarray((count, width), dtype, self.binary, start, strides).astype(np.float64)

    def tracks(self) -> Tracks:
        """Channels of the first animation, by node and path."""
        if not self.content.get("animations"):
            raise InputError(f"{self.path}: should hold an animation, got none")
        animation = self.content["animations"][0]
        found, left = {}, MAX_ARRAY_BYTES  # many channels can name one accessor
        for channel in animation["channels"]:
            target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
            if "node" not in target:
                continue
            if sampler.get("interpolation", "LINEAR") == "CUBICSPLINE":
                raise InputError(f"{self.path}: animation should be LINEAR or STEP, got CUBICSPLINE")
            output = self.content["accessors"][sampler["output"]]
            if output["componentType"] != FLOAT and not output.get("normalized"):
                raise InputError(f"{self.path}: keys should be floats or normalised integers, got plain integers")
            times = self.array(sampler["input"])[:, 0]
            values = self.array(sampler["output"]).reshape(len(times), -1)
            found[target["node"], target["path"]] = Track(times, values)
            left -= times.nbytes + values.nbytes
            if left < 0:
                raise InputError(f"{self.path}: animation should have at most {MAX_ARRAY_BYTES:,} bytes of keys")
        return found

    def shapes(self, tracks: Tracks) -> dict[int, tuple[str, ...]]:
        """Nodes with a mesh whose shapes have names, and these names (shape_names.py)."""
        found = {}
        for index, node in enumerate(self.content["nodes"]):
            names = self._target_names(node["mesh"]) if "mesh" in node else ()
            track = tracks.get((index, "weights"))
            if names and track is not None and track.values.shape[1] != len(names):
                raise InputError(f"{self.path}: weights should be {len(names)} a frame, got {track.values.shape[1]}")
            if names:
                found[index] = shape_names(names)
        return found

    def _target_names(self, mesh: int) -> tuple[str, ...]:
        """Names of the targets of a mesh, which stand beside it or beside its primitives; none if nowhere."""
        content = self.content["meshes"][mesh]
        places = (each.get("extras") for each in (content, *content["primitives"]))
        names = next((each["targetNames"] for each in places if isinstance(each, dict) and "targetNames" in each), ())
        return tuple(map(str, names))

    def line(self, node: int) -> list[int]:
        """The nodes from the root of the tree to this one. Raises InputError if the nodes are not a tree."""
        nodes = self.content["nodes"]
        parents = {child: index for index, each in enumerate(nodes) for child in each.get("children", ())}
        found = [node]
        while found[-1] in parents:
            found.append(parents[found[-1]])
            if len(found) > len(nodes):
                raise InputError(f"{self.path}: nodes should form a tree")
        return found[::-1]

    def rest_rotation(self, node: int) -> RestRotation:
        """The rotation of a node at rest."""
        *above, own = [_own_rotation(self.content["nodes"][each]) for each in self.line(node)]
        parent = Rotation.identity()
        for each in above:
            parent = parent * each
        return RestRotation(parent, own)

    def rest_position(self, node: int) -> Float[ndarray, " 3"]:
        """The position of a node at rest, in the file's axes."""
        place = np.array([0.0, 0.0, 0.0, 1.0])
        for each in reversed(self.line(node)):
            place = _own_matrix(self.content["nodes"][each]) @ place
        return place[:3]


def open_gltf(path: Path) -> GltfDocument:
    """Open a binary glTF 2.0 file. Raises InputError (one line) for anything else."""
    data = read_bytes(path)
    if data[:8] != b"glTF" + struct.pack("<I", 2) or len(data) < 28:
        raise InputError(f"{path}: should be a binary glTF 2.0 file (.glb, .vrma)")
    length = struct.unpack_from("<I", data, 12)[0]
    return GltfDocument(path, parse_json(data[20 : 20 + length]), data[20 + length + 8 :])


def _own_rotation(node: dict[str, Any]) -> Rotation:
    if "matrix" in node:
        axes = _own_matrix(node)[:3, :3]
        return Rotation.from_matrix(axes / np.linalg.norm(axes, axis=0))
    return Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0)))


def _own_matrix(node: dict[str, Any]) -> Float[ndarray, "4 4"]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    found = np.eye(4)
    found[:3, :3] = _own_rotation(node).as_matrix() * node.get("scale", (1.0, 1.0, 1.0))
    found[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return found
