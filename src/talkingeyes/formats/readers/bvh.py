"""BVH of a head: joints by name, with any order of rotation channels."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core.containers import read_text
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note

CM = 100.0
JOINT_ALIASES = {
    "head": ("head", "neck"),
    "jaw": ("jaw",),
    "left_eye": ("left_eye", "lefteye", "eyeleft", "leye"),
    "right_eye": ("right_eye", "righteye", "eyeright", "reye"),
}


@dataclass(frozen=True)
class JointChannels:
    """First column and names of the channels of a joint."""

    start: int
    names: tuple[str, ...]


def read_bvh(path: Path, fps: float | None = None) -> NotedMotion:
    """Read the motion of the joints of a head. Raises InputError if the file has none."""
    text = read_text(path, "BVH", errors="replace")
    try:
        hierarchy, rows = text.split("MOTION", 1)
        step_s = float(re.findall(r"Frame Time:\s*(\S+)", rows)[0])
        numbers = [line.split() for line in rows.splitlines() if re.match(r"\s*-?[\d.]", line)]
        values = np.array(numbers, np.float64)
        columns = _columns(hierarchy)
        if values.ndim != 2 or values.shape[1] != sum(len(each.names) for each in columns.values()) or step_s <= 0:
            raise ValueError(f"rows of {values.shape} for {len(columns)} joints")
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: not a readable BVH ({error})") from None
    names = {ours: next((name for name in theirs if name in columns), "") for ours, theirs in JOINT_ALIASES.items()}
    found = {ours: columns.get(name) for ours, name in names.items()}
    if found["head"] is None and found["left_eye"] is None:
        raise InputError(f"{path}: should have a joint head or left_eye, got {', '.join(columns)}")
    turned = {name: _turned(values, each) for name, each in found.items()}
    gaze = np.stack([turned["left_eye"], turned["right_eye"]], axis=1)
    motion = Motion.of(
        fps or round(1 / step_s, 3), turned["head"], gaze, translation=_shift(values, found["head"]), jaw=turned["jaw"]
    )
    lost = [name for name in columns if name not in names.values()]
    return NotedMotion(motion, no_place_note(lost, len(columns), "joints"))


def _columns(hierarchy: str) -> dict[str, JointChannels]:
    """Channels of each joint, by lower-case name."""
    found: dict[str, JointChannels] = {}
    name, start = "", 0
    for line in hierarchy.splitlines():
        words = line.split()
        if words[:1] in (["ROOT"], ["JOINT"]):
            name = words[1].lower()
        elif words[:1] == ["CHANNELS"]:
            found[name] = JointChannels(start, tuple(words[2 : 2 + int(words[1])]))
            start += int(words[1])
    return found


def _turned(values: Float[ndarray, "T C"], columns: JointChannels | None) -> Float[ndarray, "T 3"]:
    if columns is None:
        return np.zeros((len(values), 3))
    places = [columns.start + k for k, name in enumerate(columns.names) if name.endswith("rotation")]
    order = "".join(columns.names[place - columns.start][0].upper() for place in places)
    if not order:
        return np.zeros((len(values), 3))
    return np.asarray(Rotation.from_euler(order, values[:, places], degrees=True).as_rotvec())


def _shift(values: Float[ndarray, "T C"], columns: JointChannels | None) -> Float[ndarray, "T 3"]:
    moved = np.zeros((len(values), 3))
    for place, name in enumerate(columns.names if columns else ()):
        if columns and name.endswith("position"):
            moved[:, "XYZ".index(name[0].upper())] = values[:, columns.start + place] / CM
    return moved
