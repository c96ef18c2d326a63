"""Tables of face trackers: OpenFace 2 (Baltrusaitis et al. 2018) and py-feat.

OpenFace uses camera coordinates (z away from the camera, y down). Its eye 0 is the left one of the picture, the
subject's right. The vectors of both eyes are used if they are in the table, otherwise one angle for both. Gaze is in
space, so eye-in-head is gaze with the head's rotation removed. Its blink, AU45, ranges from 0 to 5.

py-feat uses radians, Yaw positive to the subject's right, Pitch down, Roll to the subject's right shoulder (checked on
the mesh in the same tables). Its gaze is assumed to be in space, yaw to the subject's left, pitch up. It may hold every
n-th frame of the video, so the rate of the video must be given. Its blinks are ARKit's eyeBlink, its expression the
other coefficients.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Shaped
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.gaze_datasets import read_openface
from talkingeyes.formats import arkit
from talkingeyes.formats.readers import tables
from talkingeyes.formats.rotations import from_euler_yxz

EYE_VECTORS = tuple(tuple(f"gaze_{eye}_{axis}" for axis in "xyz") for eye in (1, 0))  # left, right of the subject
TO_PROJECT_AXES = np.array([1.0, -1.0, -1.0])
MAX_AU = 5.0
MM = 1e-3


def read_openface_motion(path: Path, fps: float | None = None) -> Motion:
    """Read an OpenFace table; missing or unreliable frames repeat the value before."""
    table, recording = tables.read(path), read_openface(path)
    times_s = table.column("timestamp")
    rate = float(1 / np.median(np.diff(times_s))) if fps is None else fps
    place = np.rint((times_s - times_s[0]) * rate).astype(int)
    row = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1  # the last row at or before each frame
    space = np.repeat(recording.gaze_in_space_rad[:, None], 2, axis=1)
    if all(name in table.names for eye in EYE_VECTORS for name in eye):
        vectors = [np.stack([table.column(name) for name in eye], axis=1) * TO_PROJECT_AXES for eye in EYE_VECTORS]
        space = rotation.direction_to_angles(np.stack(vectors, axis=1))
    shift = np.zeros((len(table), 3))
    if all(f"pose_T{axis}" in table.names for axis in "xyz"):
        shift = np.stack([table.column(f"pose_T{axis}") for axis in "xyz"], axis=1) * TO_PROJECT_AXES * MM
        shift -= shift[recording.valid].mean(axis=0) if recording.valid.any() else 0.0
    shut = table.column("AU45_r") / MAX_AU if "AU45_r" in table.names else np.zeros(len(table))
    seen = recording.valid
    there = np.zeros(len(row), bool)
    there[place] = seen
    return Motion.of(
        round(rate, 3),
        _held(recording.head, seen)[row],
        _held(rotation.eye_in_head(recording.head, space), seen)[row],
        translation=_held(shift, seen)[row],
        lid=np.repeat(_held(np.clip(shut, 0.0, 1.0), seen)[row, None], 2, axis=1),
        valid=there,
    )


def read_pyfeat(path: Path, fps: float | None = None) -> Motion:
    """Read a py-feat table; `fps` is that of the video."""
    table = tables.read(path)
    if fps is None:
        raise InputError(f"{path}: should contain the frame rate of its video, got none; set --fps")
    steps = np.diff(table.column("frame"))
    if not len(steps) or not (steps == steps[0]).all() or steps[0] <= 0:
        raise InputError(
            f"{path}: should hold every frame, or every n-th, of one face, got steps of {np.unique(steps)}"
        )
    head = from_euler_yxz(np.stack([-table.column("Yaw"), table.column("Pitch"), table.column("Roll")], axis=1))
    space = np.stack([table.column("gaze_yaw"), table.column("gaze_pitch")], axis=1)
    shown = np.stack(
        [table.column(name) if name in table.names else np.zeros(len(table)) for name in arkit.NAMES], axis=1
    )
    decoded = arkit.decoded(shown)
    return Motion.of(
        fps / float(steps[0]),
        head,
        rotation.eye_in_head(head, np.repeat(space[:, None], 2, axis=1)),
        lid=decoded.lid,
        jaw=decoded.jaw,
        expression=decoded.expression,
        expression_names=arkit.EXPRESSION,
    )


def _held(values: Shaped[ndarray, "T ..."], seen: Bool[ndarray, " T"]) -> Shaped[ndarray, "T ..."]:
    """Repeat the last valid value in invalid rows (before the first valid one, the first valid value)."""
    if not seen.any():
        return values
    source = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), int(np.argmax(seen))))
    return np.asarray(values[source])
