"""What the forward axes of the eyes are in a file: lines of sight or optical axes (animation/line_of_sight.py).

Rigs look along their forward axes, so files for rigs hold lines of sight. Trackers that fit eyes to pictures follow the
iris, so their files hold optical axes. Files of this project that have texts state which they hold.
"""

from __future__ import annotations

from pathlib import Path

from talkingeyes.core.containers import read_json, read_npz
from talkingeyes.core.motion import CONVENTIONS

FORWARD_AXIS_KEY = "forward_axis"
OPTICAL_FORMATS = ("metrical-tracker", "openface", "map")  # maps start from the conventions of a Motion
OPTICAL_SCHEMAS = (CONVENTIONS["schema"], "talkingeyes.arkit/1")


def default_forward_axis(path: Path, format: str) -> str:
    """`visual` or `optical`: as the file states, else as its format usually has it."""
    if path.suffix.lower() == ".npz":
        content = read_npz(path, (FORWARD_AXIS_KEY, "schema"), f"{format} file")
    elif path.suffix.lower() == ".json":
        content = read_json(path, f"{format} file")
    else:
        content = {}
    stated, schema = (str(content.get(key, "")) for key in (FORWARD_AXIS_KEY, "schema"))
    return stated or ("optical" if format in OPTICAL_FORMATS or schema in OPTICAL_SCHEMAS else "visual")
