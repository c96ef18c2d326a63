"""ARKit's 52 coefficients with rotations of head and eyes: as CSV of Live Link Face, and as JSON.

The CSV has the names, the order and the time codes of real recordings; its angles are radians (evidence:
readers/live_link.py). The JSON adds names: coefficients per frame, rotation vectors in this project's axes.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.motion import CONVENTIONS, Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.forward_axis import FORWARD_AXIS_KEY
from talkingeyes.formats.readers.live_link import ANGLE_SIGNS, BLENDSHAPE_COUNT
from talkingeyes.formats.rotations import euler_yxz

SCHEMA = "talkingeyes.arkit/2"
DIGITS = 7


def write_live_link(motion: Motion, path: Path) -> None:
    """One row per frame; the time code starts at 0."""
    header = ("Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in arkit.NAMES), *arkit.ANGLES)
    table = np.concatenate([arkit.coefficients(motion), _angles(motion)], axis=1)
    rows = [
        ",".join([timecode(frame, motion.fps), str(BLENDSHAPE_COUNT), *(f"{value:.{DIGITS}f}" for value in row)])
        for frame, row in enumerate(table.tolist())
    ]
    with atomic_write(path) as partial:
        partial.write_text("\n".join([",".join(header), *rows]) + "\n")


def write_json(motion: Motion, path: Path, eyes: str) -> None:
    """{schema, fps, forward_axis, names, coefficients, head, eyes, translation}: one row per frame."""
    content = {
        "schema": SCHEMA,
        "fps": motion.fps,
        **{name: CONVENTIONS[name] for name in ("axes", "units", "rotations", "eye_order")},
        FORWARD_AXIS_KEY: eyes,
        "look_degrees": round(math.degrees(arkit.LOOK_RANGE_RAD), 6),
        "names": list(arkit.NAMES),
        "coefficients": _rounded(arkit.coefficients(motion)),
        "head": _rounded(motion.head),
        "eyes": _rounded(motion.gaze),
        "translation": _rounded(motion.translation),
    }
    with atomic_write(path) as partial:
        partial.write_text(json.dumps(content, separators=(",", ":")))


def timecode(frame: int, fps: float) -> str:
    """Time code HH:MM:SS:FF.fff of a frame: frames within the second at the rounded rate, and thousandths of a
    frame."""
    rate = max(round(fps), 1)
    thousandths = round(frame / fps * rate * 1000)
    seconds, left = divmod(thousandths, rate * 1000)
    return (
        f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{left // 1000:02d}.{left % 1000:03d}"
    )


def _angles(motion: Motion) -> Float[ndarray, "T 9"]:
    parts = (motion.head, motion.gaze[:, 0], motion.gaze[:, 1])
    return np.concatenate([euler_yxz(part) * ANGLE_SIGNS for part in parts], axis=1)


def _rounded(array: ndarray) -> list[object]:
    return list(np.round(array.astype(np.float64), DIGITS).tolist())
