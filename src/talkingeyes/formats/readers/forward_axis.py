"""What the forward axes of the eyes are in a file: lines of sight or optical axes (animation/line_of_sight.py).

Rigs look along their forward axes, so files for rigs hold lines of sight. Trackers that fit eyes to pictures follow the
iris, so their files hold optical axes. Files of this project state which they hold where their format has a place for
it: npz and JSON under `forward_axis`, glTF in the extras of its asset, USD in the data of its layer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from talkingeyes.core.containers import read_npz
from talkingeyes.core.motion import CONVENTIONS
from talkingeyes.formats.readers.json_layouts import read_documents

FORWARD_AXIS_KEY = "forward_axis"
LOOK_KEY = "look"  # of the open head, in the extras of the asset of a GLB
OPTICAL_FORMATS = ("metrical-tracker", "openface", "map")  # maps start from the conventions of a Motion
OPTICAL_SCHEMAS = (CONVENTIONS["schema"], "talkingeyes.arkit/1")


def default_forward_axis(path: Path, format: str) -> str:
    """`visual` or `optical`: as the file states, else as its format usually has it."""
    return stated_forward_axis(path, format) or ("optical" if format in OPTICAL_FORMATS else "visual")


def stated_forward_axis(path: Path, format: str) -> str:
    """What the file states, by its key or by its schema; empty if it states nothing."""
    content = _stating(path, format)
    stated, schema = (str(content.get(key, "")) for key in (FORWARD_AXIS_KEY, "schema"))
    return stated or ("optical" if schema in OPTICAL_SCHEMAS else "")


def _stating(path: Path, format: str) -> dict[str, Any]:
    """The part of a file in which it would state its forward axes."""
    if path.suffix.lower() == ".npz":
        return dict(read_npz(path, (FORWARD_AXIS_KEY, "schema"), f"{format} file"))
    if format == "arkit":
        return _object(read_documents(path))
    if format == "gltf":
        from talkingeyes.formats.readers.gltf_document import open_gltf

        return _object(_object(open_gltf(path).content.get("asset")).get("extras"))
    if format == "usd":
        from talkingeyes.formats.readers.usd import read_layer_data

        return read_layer_data(path)
    return {}


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
