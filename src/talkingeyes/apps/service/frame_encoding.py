"""Frames of a stream as JSON, for clients that drive their own avatar (docs/live.md).

    {"first": 12, "frames": [{"time_s", "head", "left_eye", "right_eye", "look_deg", "blendshapes"}, ...]}

`head` is a quaternion x, y, z, w about the axes of space (x to the subject's left, y up, z ahead), `left_eye` and
`right_eye` about those of the head; +z of an eye is its line of sight. `look_deg` is (yaw, pitch) of both together,
positive to the subject's left and up. `blendshapes` are ARKit's coefficients of the eyes, 0 to 1.
"""

from __future__ import annotations

import json

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.rotations import quaternions

EYE_NAMES = arkit.NAMES[: 2 * len(arkit.EYE_COEFFICIENTS)]
DIGITS = 5


def json_frames(motion: Motion, first: int) -> str:
    """A motion (gaze: lines of sight) as JSON; `first` is the number of its first frame."""
    head, left, right = (quaternions(part) for part in (motion.head, motion.gaze[:, 0], motion.gaze[:, 1]))
    look = np.degrees(rotation.cyclopean_gaze(rotation.gaze_to_angles(motion.gaze)))
    coefficients = arkit.coefficients(motion)[:, : len(EYE_NAMES)]
    frames = [
        {
            "time_s": round((first + frame) / motion.fps, DIGITS),
            "head": _rounded(head[frame]),
            "left_eye": _rounded(left[frame]),
            "right_eye": _rounded(right[frame]),
            "look_deg": _rounded(look[frame]),
            "blendshapes": dict(zip(EYE_NAMES, _rounded(coefficients[frame]), strict=True)),
        }
        for frame in range(len(motion))
    ]
    return json.dumps({"first": first, "frames": frames}, separators=(",", ":"))


def _rounded(values: Float[ndarray, " N"]) -> list[float]:
    return [round(value, DIGITS) for value in values.tolist()]
