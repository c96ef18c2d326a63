"""A glTF 2.0 document in one binary file (.glb): nodes, accessors (dense and sparse) and one animation."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write

FLOAT, UNSIGNED_INT, UNSIGNED_SHORT = 5126, 5125, 5123
COMPONENTS = {"float32": FLOAT, "uint32": UNSIGNED_INT, "uint16": UNSIGNED_SHORT}
ACCESSOR_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


@dataclass
class Gltf:
    """A document under construction: each method adds an item and returns its index."""

    document: dict[str, Any] = field(
        default_factory=lambda: {
            "asset": {"version": "2.0", "generator": "talkingeyes"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
        }
    )
    blocks: list[bytes] = field(default_factory=list)
    size: int = 0

    def node(self, name: str, **content: Any) -> int:
        """Add a node."""
        return self.add("nodes", {"name": name, **content})

    def add(self, section: str, item: dict[str, Any]) -> int:
        """Add an item to a section of the document."""
        items = self.document.setdefault(section, [])
        items.append(item)
        return len(items) - 1

    def accessor(self, array: ndarray, target: int | None = None) -> int:
        """Add an array (N), (N, 2..4) or (N, 4, 4), with its bounds; matrices are written in column-major order."""
        by_column = array.swapaxes(1, 2) if array.ndim == 3 else array
        return self.add("accessors", {"bufferView": self._view(by_column, target), **_accessor(array)})

    def sparse_accessor(self, array: Float[ndarray, "N 3"]) -> int:
        """Add an array that is mostly 0; only the other rows are stored."""
        rows = np.flatnonzero(array.any(axis=1))
        rows = rows if len(rows) else np.zeros(1, np.int64)  # a sparse accessor may not be empty
        sparse = {
            "count": len(rows),
            "indices": {"bufferView": self._view(rows.astype(np.uint32), None), "componentType": UNSIGNED_INT},
            "values": {"bufferView": self._view(array[rows], None)},
        }
        return self.add("accessors", {**_accessor(array), "sparse": sparse})

    def animate(self, channels: dict[tuple[int, str], ndarray], fps: float) -> None:
        """Add the animation: values of T frames by (node, path), linearly interpolated by players."""
        frames = len(next(iter(channels.values())))
        times = self.accessor((np.arange(frames) / fps).astype(np.float32))
        samplers: list[dict[str, Any]] = []
        targets = []
        for (node, path), values in channels.items():
            output = self.keys(path, values)
            targets.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
        self.add("animations", {"name": "motion", "channels": targets, "samplers": samplers})

    def keys(self, path: str, values: Float[ndarray, "T C"]) -> int:
        """Add the values of a channel."""
        numbers = values.astype(np.float32)
        return self.accessor(numbers.reshape(-1) if path == "weights" else numbers)

    def save(self, path: Path) -> None:
        """Write the file atomically."""
        with atomic_write(path) as partial:
            partial.write_bytes(self.encoded())

    def encoded(self) -> bytes:
        """The file as bytes."""
        binary = b"".join(self.blocks)
        document = {**self.document, "buffers": [{"byteLength": len(binary)}]}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0")
        return head + chunks + binary

    def _view(self, array: ndarray, target: int | None) -> int:
        data = np.ascontiguousarray(array).tobytes()
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        self.blocks.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.blocks[-1])
        return self.add("bufferViews", view if target is None else {**view, "target": target})


def _accessor(array: ndarray) -> dict[str, Any]:
    extension: dict[str, Any] = {
        "componentType": COMPONENTS[array.dtype.name],
        "count": len(array),
        "type": ACCESSOR_TYPES[array.shape[1:]],
    }
    if array.dtype == np.float32 and array.ndim < 3:
        extension |= {
            name: np.atleast_1d(edge(array, axis=0)).tolist() for name, edge in (("min", np.min), ("max", np.max))
        }
    return extension
