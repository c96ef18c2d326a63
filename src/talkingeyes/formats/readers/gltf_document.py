"""A glTF 2.0 file: numbers of its accessors, keys of its animations, nodes at rest, names of shapes.

Buffers are in the file (.glb), in texts of the JSON, or in files beside a .gltf, below its folder. Of an animation,
channels without a node (extensions) are ignored, as the specification demands.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from talkingeyes.core.containers import MAX_ARRAY_BYTES, parse_json, read_bytes, reading
from talkingeyes.core.errors import InputError
from talkingeyes.formats.shape_names import shape_names

FLOAT = 5126
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}  # what stands for 1 in normalised integers
STILL = 1e-6  # differences of values that are no motion
SAME_TIME_S = 1e-5  # times of frames are rounded to floats of 32 bits
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass(frozen=True)
class Track:
    """Keyframes of one node; of cubic splines also the slopes before and after each key, in units a second."""

    times_s: Float[ndarray, " K"]
    values: Float[ndarray, "K C"]
    interpolation: str = "LINEAR"
    slopes: Float[ndarray, "2 K C"] | None = None

    @property
    def moves(self) -> bool:
        """Whether the values change."""
        return bool(len(self.values) and np.ptp(self.values, axis=0).max() > STILL)

    def sampled(self, times: Float[ndarray, " T"]) -> Float[ndarray, "T C"]:
        """Values at times, interpolated as the file says."""
        if self.interpolation == "STEP":
            return self.values[np.maximum(np.searchsorted(self.times_s, times + SAME_TIME_S, "right") - 1, 0)]
        if self.slopes is None or len(self.times_s) == 1:
            return np.stack([np.interp(times, self.times_s, column) for column in self.values.T], axis=1)
        within = np.clip(times, self.times_s[0], self.times_s[-1])
        before = np.minimum(np.searchsorted(self.times_s, within, "right"), len(self.times_s) - 1) - 1
        step = (self.times_s[before + 1] - self.times_s[before])[:, None]
        part = (within - self.times_s[before])[:, None] / step
        start, stop, (incoming, outgoing) = self.values[before], self.values[before + 1], self.slopes
        bent = (1 - part) ** 2 * part * step * outgoing[before] - (1 - part) * part**2 * step * incoming[before + 1]
        return np.asarray(start + part**2 * (3 - 2 * part) * (stop - start) + bent)

    def rotations(self, times: Float[ndarray, " T"]) -> Rotation:
        """Rotations at times, with spherical interpolation of quaternions where it is linear."""
        if len(self.times_s) == 1 or self.interpolation != "LINEAR":
            return Rotation.from_quat(self.sampled(times))
        return Slerp(self.times_s, Rotation.from_quat(self.values))(np.clip(times, self.times_s[0], self.times_s[-1]))


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
    """The JSON of a file and its buffers."""

    path: Path
    content: dict[str, Any]
    buffers: Sequence[bytes]

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
        if view.get("extensions"):
            raise InputError(f"{self.path}: animation should be uncompressed, got {', '.join(view['extensions'])}")
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        strides = (view.get("byteStride") or dtype.itemsize * width, dtype.itemsize)
        return np.ndarray((count, width), dtype, self.buffers[view.get("buffer", 0)], start, strides).astype(np.float64)

    @property
    def animation_names(self) -> tuple[str, ...]:
        """The names of the animations, or their numbers. Raises InputError (one line) if there are none."""
        animations = self.content.get("animations")
        if not animations:
            raise InputError(f"{self.path}: should hold an animation, got none")
        return tuple(str(each.get("name") or number) for number, each in enumerate(animations))

    def tracks(self, number: int) -> Tracks:
        """Channels of an animation, by node and path."""
        animation = self.content["animations"][number]
        found, left = {}, MAX_ARRAY_BYTES  # many channels can name one accessor
        for channel in animation["channels"]:
            target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
            if "node" not in target:
                continue
            output = self.content["accessors"][sampler["output"]]
            if output["componentType"] != FLOAT and not output.get("normalized"):
                raise InputError(f"{self.path}: keys should be floats or normalised integers, got plain integers")
            times = self.array(sampler["input"])[:, 0]
            values, interpolation = self.array(sampler["output"]), sampler.get("interpolation", "LINEAR")
            left -= times.nbytes + values.nbytes
            if left < 0:
                raise InputError(f"{self.path}: animation should have at most {MAX_ARRAY_BYTES:,} bytes of keys")
            if interpolation == "CUBICSPLINE":
                incoming, keys, outgoing = values.reshape(len(times), 3, -1).swapaxes(0, 1)
                track = Track(times, keys, interpolation, np.stack([incoming, outgoing]))
            else:
                track = Track(times, values.reshape(len(times), -1), interpolation)
            found[target["node"], target["path"]] = track
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
    """Open a glTF 2.0 file, binary or with its buffers beside it. Raises InputError (one line) for anything else."""
    data = read_bytes(path)
    if data[:8] == b"glTF" + struct.pack("<I", 2) and len(data) >= 28:
        length = struct.unpack_from("<I", data, 12)[0]
        content, own = parse_json(data[20 : 20 + length]), data[20 + length + 8 :]
    elif path.suffix.lower() == ".gltf":
        content, own = parse_json(data), b""
    else:
        raise InputError(f"{path}: should be a binary glTF 2.0 file (.glb, .vrma)")
    places = [each.get("uri") for each in content.get("buffers", ())]
    return GltfDocument(path, content, [own if each is None else _buffer(path, each) for each in places])


def _buffer(path: Path, uri: str) -> bytes:
    """A buffer in a text, or in a file below the folder of `path`."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2], validate=True)
    folder, file = path.parent.resolve(), (path.parent / unquote(uri)).resolve()
    if not file.is_relative_to(folder):
        raise InputError(f"{path}: buffers should be in files below its folder, got {uri}")
    with reading(path, f"glTF with its buffer {uri}"):
        return read_bytes(file)


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
