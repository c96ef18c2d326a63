"""The joints of head, jaw and eyes in a glTF file, and their turns in the axes of a Motion.

Which nodes they are follows from the user's names, else from the humanoid of a VRM extension, else from names
(joint_names.py). The turn of the head is that of neck and head together, that of an eye of all nodes between head and
eye. A rig that faces another way than +z (VRM 0.x faces -z) is turned, by where its left and right eye are.

Of several animations, the one of the user's name is taken, else the first that moves a face, else the first that has
keys for one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from talkingeyes.core.errors import InputError
from talkingeyes.formats.joint_names import JOINTS, joints_by_name, list_names
from talkingeyes.formats.readers.gltf_document import GltfDocument, Track, Tracks, open_gltf

VRM_ANIMATION = "VRMC_vrm_animation"
VRM_EXTENSIONS = (VRM_ANIMATION, "VRMC_vrm", "VRM")
HUMAN_BONES = {"head": "head", "neck": "neck", "jaw": "jaw", "leftEye": "left_eye", "rightEye": "right_eye"}


@dataclass(frozen=True)
class Rig:
    """A file with the nodes of its joints, for the animation of this number, whose channels are `tracks`.

    `facing` turns the axes of a Motion into those of the file.
    """

    document: GltfDocument
    animation: int
    tracks: Tracks
    joints: Mapping[str, int]
    facing: Rotation

    def path(self, joint: str) -> list[int]:
        """The nodes that turn a joint, from the top: those from neck to head, or those below the head."""
        node = self.joints[joint]
        line, top = self.document.line(node), self.joints.get("neck" if joint == "head" else "head")
        if top is None or top == node or top not in line:
            return [node]
        return line[line.index(top) + (joint != "head") :]

    def keys(self, joint: str) -> list[tuple[int, str]]:
        """The tracks that turn a joint."""
        path = self.path(joint) if joint in self.joints else ()
        return [(node, "rotation") for node in path if (node, "rotation") in self.tracks]

    def moves(self, joint: str) -> bool:
        """Whether something turns a joint."""
        return any(self.tracks[key].moves for key in self.keys(joint))

    @property
    def face_tracks(self) -> list[Track]:
        """The tracks of joints and of shapes with names."""
        joints = [self.tracks[key] for joint in JOINTS for key in self.keys(joint)]
        shown = self.document.shapes(self.tracks)
        return joints + [self.tracks[node, "weights"] for node in shown if (node, "weights") in self.tracks]

    @property
    def notes(self) -> tuple[str, ...]:
        """What is said where the file has several animations."""
        names = self.document.animation_names
        others = list_names([name for number, name in enumerate(names) if number != self.animation])
        taken = names[self.animation]
        return (f"animation {taken}; --animation NAME takes another: {others}",) if len(names) > 1 else ()

    def turns(self, joint: str, times: Float[ndarray, " T"]) -> Float[ndarray, "T 3"]:
        """Rotation vectors of a joint from rest; 0 if nothing turns it."""
        turned = self._turned([node for node, _ in self.keys(joint)], times)
        return np.asarray(self.facing.inv().apply(turned.as_rotvec()))

    def own_rotations(
        self, joint: str, turn: Float[ndarray, "T 3"], times: Float[ndarray, " T"]
    ) -> Float[ndarray, "T 3"]:
        """The rotation vectors of a joint's own node, under which `turns` is `turn`."""
        *above, node = self.path(joint)
        others = self._turned([each for each in above if (each, "rotation") in self.tracks], times)
        wanted = others.inv() * Rotation.from_rotvec(self.facing.apply(turn))
        return np.asarray(self.document.rest_rotation(node).from_file_axes(wanted).as_rotvec())

    def _turned(self, nodes: Sequence[int], times: Float[ndarray, " T"]) -> Rotation:
        """The turn from rest about the file's axes of nodes below each other."""
        turned = Rotation.identity(len(times))
        for node in nodes:
            local = self.tracks[node, "rotation"].rotations(times)
            turned = turned * self.document.rest_rotation(node).to_file_axes(local)
        return turned


def open_rig(path: Path, given: Mapping[str, str] | None = None, animation: str | None = None) -> Rig:
    """Open a file; `given` are names of nodes by joint. Raises InputError (one line) for names that it has not."""
    document = open_gltf(path)
    names = document.animation_names
    if animation is not None and animation not in names:
        raise InputError(f"{path}: animation should be one of {list_names(names)}, got {animation}")
    numbers = range(len(names)) if animation is None else [names.index(animation)]
    with_keys: Rig | None = None
    for number in numbers:
        rig = find_rig(document, number, given)
        if any(track.moves for track in rig.face_tracks):
            return rig
        with_keys = with_keys or (rig if rig.face_tracks else None)
    return with_keys or rig


def find_rig(document: GltfDocument, animation: int, given: Mapping[str, str] | None = None) -> Rig:
    """The rig for an animation; `given` are names of nodes by joint. Raises InputError for a name that no node has."""
    tracks = document.tracks(animation)
    extensions = document.content.get("extensions", {})
    nodes, joints = document.content["nodes"], _humanoid(extensions)
    skinned = {joint for skin in document.content.get("skins", ()) for joint in skin["joints"]}

    # A mesh that is skinned is not turned by its own node.
    names = ["" if "skin" in node else str(node.get("name", "")) for node in nodes]

    def first(found: Sequence[int]) -> int:
        """Of nodes, the likeliest first: one that turns a skin; of several of one name, the animated one."""
        by_name = [names[node] for node in found]
        return min(
            found,
            key=lambda node: (node not in skinned, by_name.index(names[node]), (node, "rotation") not in tracks),
        )

    if VRM_ANIMATION not in extensions:
        joints = {joint: first(found) for joint, found in joints_by_name(names).items()} | joints
    for joint, name in (given or {}).items():
        if name not in names:
            raise InputError(f"{document.path}: joint {joint} should be one of {list_names(names)}, got {name}")
        joints[joint] = first([node for node, own in enumerate(names) if own == name])
    if "head" not in joints and "neck" in joints:
        joints["head"] = joints["neck"]
    return Rig(document, animation, tracks, joints, _facing(document, joints, "VRM" in extensions))


def _humanoid(extensions: Mapping[str, Any]) -> dict[str, int]:
    """Joints by the humanoid of VRM; 0.x has a list of bones."""
    found: Any = next((extensions[name]["humanoid"]["humanBones"] for name in VRM_EXTENSIONS if name in extensions), {})
    bones = {each["bone"]: each["node"] for each in found} if isinstance(found, list) else found
    nodes = {name: bone["node"] if isinstance(bone, dict) else bone for name, bone in bones.items()}
    return {ours: int(nodes[theirs]) for theirs, ours in HUMAN_BONES.items() if nodes.get(theirs, -1) >= 0}


def _facing(document: GltfDocument, joints: Mapping[str, int], is_vrm0: bool) -> Rotation:
    """Quarter turns about the vertical axis from a head that faces +z to that of the file."""
    quarters = 2 if is_vrm0 else 0
    if {"left_eye", "right_eye"} <= joints.keys():
        to_left = document.rest_position(joints["left_eye"]) - document.rest_position(joints["right_eye"])
        if np.hypot(to_left[0], to_left[2]) > 2 * abs(to_left[1]):
            quarters = round(float(np.arctan2(-to_left[2], to_left[0]) / (np.pi / 2)))
    return Rotation.from_euler("y", quarters % 4 * 90, degrees=True)
