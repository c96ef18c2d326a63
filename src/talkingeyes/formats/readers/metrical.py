"""Checkpoints of metrical-tracker: a folder of `.frame` files, one per frame, or a single one.

Each holds `flame` (exp, eyes and jaw as six numbers per joint, the first two rows of the matrix, left eye first;
eyelids) and `opencv` (R, t of the head in a camera that looks along +z with y down). There the head is static and the
camera moves, so the head's rotation is diag(1, -1, -1) R, and its translation diag(1, -1, -1) t, relative to the mean
of the clip.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.flame_parameters import EXPRESSION, HEAD_MODEL
from talkingeyes.formats.readers.torch_file import read_torch
from talkingeyes.formats.rotations import to_rotation_vectors
from talkingeyes.head.restricted_pickle import as_array

FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


def read_metrical(path: Path, fps: float | None = None) -> Motion:
    """Read the motion of a folder of checkpoints, in the order of their names."""
    files = sorted(path.glob("*.frame")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: should hold .frame files of metrical-tracker, got none")
    if fps is None:
        raise InputError(f"{path}: should contain its frame rate, got none; set --fps")
    frames = [_frame(file) for file in files]
    stacked = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    shift = stacked["t"] @ FROM_OPENCV
    eyes = stacked["eyes"].reshape(-1, 6)
    return Motion.of(
        fps,
        rotation.matrix_to_rotvec(FROM_OPENCV @ stacked["R"].reshape(-1, 3, 3)),
        to_rotation_vectors(eyes, "six_d").reshape(-1, 2, 3),
        translation=shift - shift.mean(axis=0),
        lid=stacked["eyelids"],
        jaw=to_rotation_vectors(stacked["jaw"], "six_d"),
        expression=stacked["exp"],
        expression_names=tuple(EXPRESSION.format(number) for number in range(stacked["exp"].shape[1])),
        head_model=HEAD_MODEL,
    )


def _frame(path: Path) -> dict[str, ndarray]:
    content = read_torch(path)
    found: dict[str, Any] = {}
    if isinstance(content, Mapping):
        for part in ("flame", "opencv"):
            section = content.get(part)
            found |= section if isinstance(section, Mapping) else {}
    sizes = {"eyes": 12, "jaw": 6, "R": 9, "t": 3, "exp": None, "eyelids": 2}
    found.setdefault("eyelids", np.zeros(2))
    missing = [name for name in sizes if name not in found]
    if missing:
        raise InputError(f"{path}: should be a frame of metrical-tracker with {missing[0]}, got {', '.join(found)}")
    arrays = {name: np.asarray(as_array(found[name]), np.float64).reshape(-1) for name in sizes}
    wrong = [name for name, size in sizes.items() if size is not None and arrays[name].shape != (size,)]
    if wrong:
        raise InputError(f"{path}: {wrong[0]} should hold {sizes[wrong[0]]} numbers, got {arrays[wrong[0]].size}")
    return arrays
