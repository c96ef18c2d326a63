"""ARKit coefficients as JSON, in the layouts of json_layouts.py, read by name (shape_names.py) in any order.

Ours (`export -f arkit`) has rotations of head and eyes and the translation beside them, MediaPipe the head as a matrix
(its camera looks along -z with y up, so the axes are ours). Without rotations, gaze follows from the coefficients.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.fitting.gaps import interpolate_gaps
from talkingeyes.formats.readers.clock import Timing, row_timing
from talkingeyes.formats.readers.json_layouts import CoefficientRows, coefficient_rows, read_documents
from talkingeyes.formats.readers.live_link import check_shapes, motion_of, take_of
from talkingeyes.formats.readers.noted import NotedMotion

CM = 1e-2
OWN_KEYS = {"head": "head", "eyes": "gaze", "translation": "translation"}  # of our JSON, and the fields of a motion


def read_arkit_json(path: Path, fps: float | None = None) -> NotedMotion:
    """Read a motion. Raises InputError (one line) if the file has none."""
    content = read_documents(path)
    found = coefficient_rows(path, content)
    check_shapes(found.names)
    timing = json_timing(path, found, fps)
    try:
        rows = np.array(found.rows, np.float64)  # None becomes NaN
        columns = dict(zip(found.names, rows.T, strict=True))
        own: dict[str, Any] = {
            field: np.asarray(content[key], np.float64)
            for key, field in OWN_KEYS.items()
            if isinstance(content, dict) and key in content
        }
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: rows should be numbers, one for each name ({error})") from None
    take = take_of(columns, timing)
    motion = replace(motion_of(take), **own)
    return NotedMotion(_with_matrices(motion, found, timing) if found.matrices else motion, take.notes)


def json_timing(path: Path, found: CoefficientRows, fps: float | None) -> Timing:
    """The timing of rows. Raises InputError (one line) if it follows from nothing."""
    rate = found.fps if fps is None else fps
    if rate is not None:
        return Timing(rate, np.arange(len(found.rows)))
    if not found.times:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps")
    return row_timing(found.times, len(found.rows), None)


def _with_matrices(motion: Motion, found: CoefficientRows, timing: Timing) -> Motion:
    """The motion with the head of MediaPipe's matrices, in centimetres; its place relative to the mean."""
    known = np.array([bool(each) for each in found.matrices])
    poses = np.zeros((len(known), 6))
    poses[known] = [_pose(each) for each in found.matrices if each]
    seen = timing.on_frames(known)
    turns, places = np.split(interpolate_gaps(timing.on_frames(poses), seen), 2, axis=1)
    return replace(motion, head=turns, translation=(places - places[seen].mean(axis=0)) * CM, valid=motion.valid & seen)


def _pose(matrix: Any) -> Float[ndarray, " 6"]:
    """Rotation vector and place of a matrix of 4 by 4, by rows or by columns; of several faces, the first."""
    while isinstance(matrix, list) and matrix and isinstance(matrix[0], dict):
        matrix = matrix[0]
    numbers = np.array(matrix["data"] if isinstance(matrix, dict) else matrix, np.float64).ravel()[:16].reshape(4, 4)
    pose = numbers if np.abs(numbers[3, :3]).max() <= np.abs(numbers[:3, 3]).max() else numbers.T
    return np.concatenate([rotation.matrix_to_rotvec(pose[:3, :3]), pose[:3, 3]])
