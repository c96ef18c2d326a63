"""BVH of a head: joints by name (joint_names.py), with any order of rotation channels.

The turn of the head is that of neck and head together, as in glTF.
"""

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
from talkingeyes.formats.joint_names import JOINTS, joints_by_name, list_names
from talkingeyes.formats.readers.clock import usual_rate
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note
from talkingeyes.formats.rotations import compose_rotations

CM = 100.0
STEP_DIGITS = 5e-7  # rounding of the time of a frame, of six digits


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
    listed = list(columns)
    names = {joint: listed[indices[0]] for joint, indices in joints_by_name(listed).items()}
    if not {"head", "neck", "left_eye"} & names.keys():
        raise InputError(f"{path}: should have a joint head or left_eye, got {list_names(listed)}")
    turned = {joint: _turned(values, columns.get(names.get(joint, ""))) for joint in JOINTS}
    gaze = np.stack([turned["left_eye"], turned["right_eye"]], axis=1)
    motion = Motion.of(
        fps or usual_rate(1 / step_s, STEP_DIGITS / step_s + 1e-9),
        compose_rotations(turned["neck"], turned["head"]),
        gaze,
        translation=_shift(values, columns.get(names.get("head", ""))),
        jaw=turned["jaw"],
    )
    lost = [name for name in columns if name not in names.values()]
    return NotedMotion(motion, no_place_note(lost, len(columns), "joints"))


def _columns(hierarchy: str) -> dict[str, JointChannels]:
    """Channels of each joint, by name."""
    found: dict[str, JointChannels] = {}
    name, start = "", 0
    for line in hierarchy.splitlines():
        words = line.split()
        if words[:1] in (["ROOT"], ["JOINT"]):
            name = " ".join(words[1:])
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
