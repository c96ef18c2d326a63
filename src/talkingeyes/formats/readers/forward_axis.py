"""What the forward axes of the eyes are in a file: lines of sight or optical axes (animation/line_of_sight.py).

Rigs look along their forward axes, so files for rigs hold lines of sight. Trackers that fit eyes to pictures follow the
iris, so their files hold optical axes. Files of this project that have texts state which they hold.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from talkingeyes.core.motion import CONVENTIONS

FORWARD_AXIS_KEY = "forward_axis"
OPTICAL_FORMATS = ("metrical-tracker", "openface", "map")  # maps start from the conventions of a Motion
OPTICAL_SCHEMAS = (CONVENTIONS["schema"], "talkingeyes.arkit/1")


def default_forward_axis(path: Path, format: str) -> str:
    """`visual` or `optical`: as the file states, else as its format usually has it."""
    stated, schema = "", ""
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as file:
            stated, schema = (str(file[key]) if key in file.files else "" for key in (FORWARD_AXIS_KEY, "schema"))
    elif path.suffix.lower() == ".json":
        content = json.loads(path.read_text())
        stated, schema = (str(content.get(key, "")) for key in (FORWARD_AXIS_KEY, "schema"))
    return stated or ("optical" if format in OPTICAL_FORMATS or schema in OPTICAL_SCHEMAS else "visual")
