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

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.gaze_datasets import MIN_CONFIDENCE
from talkingeyes.fitting.gaps import hold_last, interpolate_gaps
from talkingeyes.formats import arkit
from talkingeyes.formats.readers import tables
from talkingeyes.formats.readers.clock import Timing, row_timing
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note
from talkingeyes.formats.rotations import from_euler_yxz

TURNS, PLACE = (tuple(f"pose_{kind}{axis}" for axis in "xyz") for kind in "RT")
EYE_VECTORS = tuple(tuple(f"gaze_{eye}_{axis}" for axis in "xyz") for eye in (1, 0))  # left, right of the subject
TO_PROJECT_AXES = np.array([1.0, -1.0, -1.0])
MAX_AU = 5.0
MM = 1e-3


def read_openface_motion(path: Path, fps: float | None = None) -> NotedMotion:
    """Read an OpenFace table; missing or unreliable frames repeat the value before."""
    table = tables.read(path)
    faces = set(table.texts("face_id")) if "face_id" in table.names else {""}
    if len(faces) > 1:
        raise InputError(f"{path}: should hold one face, got those of face_id {', '.join(sorted(faces))}")
    timing = row_timing(table.texts("timestamp"), len(table), fps)
    head = Rotation.from_euler("XYZ", table.columns(*TURNS)).as_rotvec() * TO_PROJECT_AXES
    space = np.repeat((table.columns("gaze_angle_x", "gaze_angle_y") * [1.0, -1.0])[:, None], 2, axis=1)
    if all(name in table.names for eye in EYE_VECTORS for name in eye):
        vectors = [table.columns(*eye) * TO_PROJECT_AXES for eye in EYE_VECTORS]
        space = rotation.direction_to_angles(np.stack(vectors, axis=1))
    shift = table.columns(*PLACE, absent=0.0) * TO_PROJECT_AXES * MM
    shut = np.repeat(np.clip(table.columns("AU45_r", absent=0.0) / MAX_AU, 0.0, 1.0), 2, axis=1)
    seen = (table.column("confidence") >= MIN_CONFIDENCE) & (table.column("success") > 0)
    seen &= np.isfinite(np.concatenate([head, space.reshape(-1, 4), shift, shut], axis=1)).all(axis=1)
    shift -= shift[seen].mean(axis=0) if seen.any() else 0.0
    valid = timing.on_frames(seen)
    rows = (head, rotation.eye_in_head(head, space), shift, shut)
    head, gaze, shift, lid = (hold_last(timing.on_frames(each), valid) for each in rows)
    motion = Motion.of(timing.fps, head, gaze, translation=shift, lid=lid, valid=valid)
    return NotedMotion(motion, _action_units(table, "AU45_r", "AU45_c"))


@dataclass(frozen=True)
class PyfeatRows:
    """Rows of a py-feat table: turns of the head, gaze in space, ARKit's coefficients; timing; which have a face."""

    table: tables.Table
    values: Float[ndarray, "T 57"]
    seen: Bool[ndarray, " T"]
    timing: Timing


def read_pyfeat(path: Path, fps: float | None = None) -> NotedMotion:
    """Read a py-feat table; `fps` is that of the video. Frames without a face are interpolated, and not valid."""
    rows = pyfeat_rows(path, fps)
    valid = rows.timing.on_frames(rows.seen)
    turns, space, shown = np.split(interpolate_gaps(rows.timing.on_frames(rows.values), valid), [3, 5], axis=1)
    head, decoded = from_euler_yxz(turns * [-1.0, 1.0, 1.0]), arkit.decoded(shown)
    motion = Motion.of(
        rows.timing.fps,
        head,
        rotation.eye_in_head(head, np.repeat(space[:, None], 2, axis=1)),
        lid=decoded.lid,
        jaw=decoded.jaw,
        expression=decoded.expression,
        expression_names=arkit.EXPRESSION,
        valid=valid,
    )
    return NotedMotion(motion, _action_units(rows.table))


def _action_units(table: tables.Table, *read: str) -> tuple[str, ...]:
    found = [name for name in table.names if re.match(r"AU\d", name)]
    return no_place_note([name for name in found if name not in read], len(found), "action units")


def pyfeat_rows(path: Path, fps: float | None) -> PyfeatRows:
    """The rows of a py-feat table, which are every n-th frame of a video of this rate."""
    table = tables.read(path)
    if fps is None:
        raise InputError(f"{path}: should contain the frame rate of its video, got none; set --fps")
    numbers = np.rint(table.column("frame")).astype(int)
    steps = np.diff(numbers)
    if not len(steps) or steps.min() <= 0:
        raise InputError(
            f"{path}: should hold every frame, or every n-th, of one face, got steps of {np.unique(steps)}"
        )
    step = int(np.gcd.reduce(steps))
    angles = table.columns("Yaw", "Pitch", "Roll", "gaze_yaw", "gaze_pitch")
    values = np.concatenate([angles, table.columns(*arkit.NAMES, absent=0.0)], axis=1)
    return PyfeatRows(
        table, values, np.isfinite(values).all(axis=1), Timing(fps / step, (numbers - numbers[0]) // step)
    )
