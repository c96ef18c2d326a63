"""FLAME parameters with an npz for each frame, in a folder (GaussianAvatars, VHAP): 00000.npz, 00001.npz, ...

A folder is one motion if most of its npz files differ by one number in their names, and the first holds a single frame
of FLAME parameters. Frames follow in the order of the numbers; numbers that are missing are frames without values.
Other files (canonical_flame_param.npz) are noted.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from talkingeyes.core.containers import read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.fitting.gaps import interpolate_gaps
from talkingeyes.formats.readers.clock import Timing
from talkingeyes.formats.readers.flame_parameters import PARAMETER_KEYS, array_notes, motion_from_arrays
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note

MAX_FRAMES = 1_000_000  # 4.6 hours at 60 frames per second


def frame_files(folder: Path) -> dict[int, Path]:
    """The files of a folder by the number of their frame; none if the folder is not one motion."""
    files, named = _npz_files(folder), dict[tuple[str, ...], list[Path]]()
    for path in files:
        named.setdefault(tuple(re.split(r"\d+", path.stem)), []).append(path)
    group = max(named.values(), key=len, default=[])
    numbers = [re.findall(r"\d+", path.stem) for path in group]
    varying = [texts for texts in zip(*numbers, strict=True) if len(set(texts)) > 1]
    if len(varying) != 1 or 2 * len(group) <= len(files):
        return {}
    found = {int(number): path for number, path in zip(varying[0], group, strict=True)}
    content = read_npz(found[min(found)], {*PARAMETER_KEYS, "schema"}, "npz")
    is_frame = content and "schema" not in content and all(len(_rows(each)) == 1 for each in content.values())
    return dict(sorted(found.items())) if is_frame and len(found) == len(group) else {}


def _npz_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".npz")


def read_flame_frames(path: Path, fps: float | None = None) -> NotedMotion:
    """Read a folder of frames; those that are missing are interpolated, and not valid."""
    files = frame_files(path)
    numbers = np.array(list(files))
    frames = (numbers - numbers[0]) // np.gcd.reduce(np.diff(numbers))  # which may be every tenth
    if frames[-1] >= MAX_FRAMES:
        raise InputError(f"{path}: should have at most {MAX_FRAMES:,} frames, got numbers to {numbers[-1]}")
    content = [read_npz(file, {*PARAMETER_KEYS, "fps"}, "npz") for file in files.values()]
    timing = Timing(1.0, frames)
    valid = timing.on_frames(np.ones(len(frames), bool))
    stacked = {}
    for name in PARAMETER_KEYS & content[0].keys():
        rows = [_row(file, name, each) for file, each in zip(files.values(), content, strict=True)]
        stacked[name] = interpolate_gaps(timing.on_frames(np.stack(rows)), valid)
    rate = {"fps": content[0]["fps"]} if "fps" in content[0] else {}
    motion = replace(motion_from_arrays(path, stacked | rate, fps), valid=valid)
    others = [file.name for file in _npz_files(path) if file not in files.values()]
    return NotedMotion(
        motion, (*array_notes(files[int(numbers[0])]), *no_place_note(others, len(others) + len(files), "files"))
    )


def _row(path: Path, name: str, content: dict[str, ndarray]) -> ndarray:
    rows = _rows(content[name]) if name in content else np.zeros((0, 0))
    if len(rows) != 1:
        raise InputError(f"{path}: should hold one frame of {name}, as the first file does, got {len(rows)}")
    return np.asarray(rows[0])


def _rows(array: ndarray) -> ndarray:
    """An array of parameters with a row for each frame."""
    return np.atleast_2d(array)
