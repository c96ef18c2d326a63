"""Reader of motion files for evaluation: their fields, and the clip that each belongs to.

Input: npz without pickles with `fps` and at least one of head (T, 3), gaze (T, 2, 3) and lid (T, 2), or S samples of
them (S, T, ...); optionally `valid` (T). Motion files, the output of `sample`, and files of others that follow
docs/conventions.md are all accepted, and only the needed arrays are read.

A file belongs to the clip in its name: <clip>.npz, <clip>-s3.npz, <clip>_sample_03.npz, or <clip>/sample_03.npz.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from numpy import ndarray

from talkingeyes.core.containers import npz_names, read_npz
from talkingeyes.core.errors import InputError

FRAME_DIMENSIONS = {"head": 1, "gaze": 2, "lid": 1}
SAMPLE_NAME = re.compile(r"(?:(?P<clip>.+?)[-_.])?s(?:ample)?[-_]?\d+")


@dataclass(frozen=True)
class MotionFields:
    """One motion of a file, with the fields that it contains."""

    fps: float
    fields: dict[str, ndarray]
    valid: ndarray | None


def motion_files(folder: Path) -> dict[str, list[Path]]:
    """Clip names with their files, sorted. Raises InputError if there is no file."""
    found: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*.npz")):
        if not any(part.startswith(".") for part in path.relative_to(folder).parts):
            found[clip_id_of(path)].append(path)
    if not found:
        raise InputError(f"{folder}: should hold motion files (.npz), got none; `talkingeyes import` converts others")
    return dict(sorted(found.items()))


def clip_id_of(path: Path) -> str:
    """The name of the clip that a file belongs to."""
    match = SAMPLE_NAME.fullmatch(path.stem)
    if not match:
        return path.stem
    return match["clip"] or path.resolve().parent.name


def read_motions(path: Path) -> Iterator[MotionFields]:
    """Read the motions of a file: one, or S samples. Raises InputError for other files."""
    content = read_npz(path, {*FRAME_DIMENSIONS, "fps", "valid"}, "motion npz")
    if "fps" not in content:
        names = ", ".join(npz_names(path, "motion npz")) or "nothing"
        raise InputError(f"{path}: should hold fps, got {names}; `talkingeyes import` converts files of others")
    try:
        fps = float(content["fps"])
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: fps should be a number ({error})") from None
    fields = {name: content[name] for name in FRAME_DIMENSIONS if name in content}
    valid = content.get("valid")
    stacked = {name: array.ndim == FRAME_DIMENSIONS[name] + 2 for name, array in fields.items()}
    if not any(stacked.values()):
        yield MotionFields(fps, fields, valid)
        return
    counts = {len(array) for array in fields.values()}
    if not all(stacked.values()) or len(counts) > 1:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in fields.items())
        raise InputError(f"{path}: all fields should have the same number of samples, got {shapes}")
    for sample in range(counts.pop()):
        yield MotionFields(fps, {name: array[sample] for name, array in fields.items()}, valid)
