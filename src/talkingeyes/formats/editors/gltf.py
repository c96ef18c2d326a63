"""Edits the animation of a GLB or a VRM animation: channels of eyes, lids and head; all other data keep their bytes.

The binary buffer stays as it is and new keys are appended, so a channel of lips reads the numbers that it read before.
Weights of one mesh are one channel, so that of a face is written again, with the other columns unchanged.

Which channels turn the eyes of a GLB: those that move in the file; where none does, look coefficients if the face has
them, otherwise joints. Heads with the shapes of the Eyelid model (ours) have joints for eyes and these shapes for lids.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.editors.channels import EYE_NAMES, AddedEyes, channel_name, eye_channels
from talkingeyes.formats.joint_names import list_names
from talkingeyes.formats.readers.gltf import head_of
from talkingeyes.formats.readers.gltf_document import STILL, GltfDocument, Track, Tracks
from talkingeyes.formats.readers.gltf_rig import VRM_ANIMATION, Rig, open_rig
from talkingeyes.formats.rotations import quaternions
from talkingeyes.formats.writers import vrm
from talkingeyes.formats.writers.gltf import Gltf
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES
from talkingeyes.head.posing import motion_to_pose

LOOK_PRESETS = ("lookUp", "lookDown", "lookLeft", "lookRight")  # of VRM, beside the look-at
EYES = ("left_eye", "right_eye")

OWN_SHAPES = EYE_NAMES | {name.lower() for name in LID_SHAPES}

Channels = dict[tuple[int, str], Float[ndarray, "T C"]]


@dataclass(frozen=True)
class GltfFile:
    """A file with an animation, and the times of its frames."""

    rig: Rig
    times_s: Float[ndarray, " T"]

    @property
    def has_head(self) -> bool:
        return "head" in self.rig.joints

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head."""
        content, [binary] = self.rig.document.content, self.rig.document.buffers
        size = content["buffers"][0]["byteLength"]
        used = binary[:size] + b"\0" * (-size % 4)
        gltf = Gltf(document=deepcopy(content), blocks=[used], size=len(used))
        is_vrm = VRM_ANIMATION in content.get("extensions", {})
        channels = self._vrm(gltf, added) if is_vrm else self._eyes(added) | self._faces(added)
        if added.with_head and self.has_head:
            channels |= self._turned("head", added.motion.head, added)
        if added.share == 0:
            channels = {target: values for target, values in channels.items() if target not in self.rig.tracks}
        self._write(gltf, channels)
        return gltf.encoded()

    def _write(self, gltf: Gltf, channels: Channels) -> None:
        """Replace or add channels of the animation; a channel with a key for each frame keeps its times."""
        animation = gltf.document["animations"][self.rig.animation]
        times: int | None = None
        for (node, path), values in channels.items():
            target = {"node": node, "path": path}
            channel = next((each for each in animation["channels"] if _is_at(each, node, path)), None)
            track = self.rig.tracks.get((node, path))
            if channel is not None and track is not None and self._has_key_per_frame(track):
                given = animation["samplers"][channel["sampler"]]["input"]
            else:
                times = gltf.accessor(self.times_s.astype(np.float32)) if times is None else times
                given = times
            sampler = {"input": given, "output": gltf.keys(path, values), "interpolation": "LINEAR"}
            animation["samplers"].append(sampler)
            if channel is None:
                animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
            else:
                channel["sampler"] = len(animation["samplers"]) - 1

    def _has_key_per_frame(self, track: Track) -> bool:
        return len(track.times_s) == len(self.times_s)

    def _turned(self, joint: str, turn: Float[ndarray, "T 3"], added: AddedEyes) -> Channels:
        """The channel of a joint, for turns from rest about the axes of a Motion."""
        if self.rig.keys(joint):
            turn = added.mixed_turns(self.rig.turns(joint, self.times_s), turn)
        own = self.rig.own_rotations(joint, turn, self.times_s)
        return {(self.rig.joints[joint], "rotation"): quaternions(own)}

    def _eyes(self, added: AddedEyes) -> Channels:
        channels: Channels = {}
        for eye, joint in enumerate(EYES if self._joints_turn_eyes() else ()):
            channels |= self._turned(joint, added.motion.gaze[:, eye], added)
        return channels

    def _joints_turn_eyes(self) -> bool:
        """Whether joints, not shapes, turn the eyes."""
        if not set(EYES) <= self.rig.joints.keys():
            return False
        named = set().union(*self.face_names().values())
        return any(map(self.rig.moves, EYES)) or LID_SHAPES[0].lower() in named or "eyelookupleft" not in named

    def face_names(self) -> dict[int, list[str]]:
        """Nodes with a mesh that has shapes of eyes, and the names of its shapes."""
        shapes = self.rig.document.shapes(self.rig.tracks)
        found = {node: [name.lower() for name in names] for node, names in shapes.items()}
        return {node: names for node, names in found.items() if not OWN_SHAPES.isdisjoint(names)}

    def _faces(self, added: AddedEyes) -> Channels:
        """Weights of the faces, with new columns of eyes and lids."""
        channels: Channels = {}
        looks_turn_eyes = not self._joints_turn_eyes()
        for node, names in self.face_names().items():
            track = self.rig.tracks.get((node, "weights"))
            weights = self._still_weights(node, len(names)) if track is None else self._kept(track)
            moving = track is not None and any(
                np.ptp(weights[:, column]) > STILL for column, name in enumerate(names) if name.startswith("eyelook")
            )
            for name, values in _shapes(added.motion, self.rig.document, names, looks_turn_eyes or moving).items():
                column = names.index(name)
                weights[:, column] = values if track is None else added.mixed(weights[:, column], values)
            channels[node, "weights"] = weights
        return channels

    def _still_weights(self, node: int, count: int) -> Float[ndarray, "T C"]:
        """The weights of a face that no channel moves."""
        content = self.rig.document.content
        holders = (content["nodes"][node], content["meshes"][content["nodes"][node]["mesh"]])
        still = next((each["weights"] for each in holders if "weights" in each), [0.0] * count)
        return np.tile(np.array(still, np.float64), (len(self.times_s), 1))

    def _kept(self, track: Track) -> Float[ndarray, "T C"]:
        return track.values.copy() if self._has_key_per_frame(track) else track.sampled(self.times_s)

    def _vrm(self, gltf: Gltf, added: AddedEyes) -> Channels:
        """Look-at and blinks; nodes that the file lacks are added. ARKit's names among its own expressions get ours."""
        extension = gltf.document["extensions"][VRM_ANIMATION]
        shown = extension.setdefault("expressions", {})
        preset, custom = shown.setdefault("preset", {}), shown.get("custom", {})
        animated = {
            name: place["node"]
            for name, place in (*custom.items(), *preset.items())
            if (place["node"], "translation") in self.rig.tracks
        }
        ours, still = eye_channels(added.motion), np.zeros(len(self.times_s))
        shapes = {name: ours[channel_name(name)] for name in animated if name in custom and channel_name(name) in ours}
        weights = shapes | {name: still for name in ("blink", *LOOK_PRESETS) if name in animated}
        if not any(channel_name(name).startswith("eyeblink") for name in shapes):
            weights |= {name: each for name, each in vrm.expressions(added.motion).items() if name.startswith("blink")}
        channels: Channels = {}
        for name, values in weights.items():
            if name not in animated and name not in preset:
                preset[name] = {"node": _root(gltf, name)}
            channels |= self._expression(animated[name] if name in animated else preset[name]["node"], values, added)
        if any(channel_name(name).startswith("eyelook") for name in shapes) and "lookAt" not in extension:
            return channels  # the eyes are turned by expressions
        if "lookAt" not in extension:
            extension["lookAt"] = {"node": _root(gltf, "lookAt"), "offsetFromHeadBone": vrm.OFFSET_FROM_HEAD}
        looks, node = vrm.look_at(added.motion), extension["lookAt"]["node"]
        if (node, "rotation") in self.rig.tracks:  # players take it as it is, whatever the node's rotation at rest
            own = self.rig.tracks[node, "rotation"].rotations(self.times_s)
            looks = added.mixed_turns(own.as_rotvec(), looks)
        return channels | {(node, "rotation"): quaternions(looks)}

    def _expression(self, node: int, values: Float[ndarray, " T"], added: AddedEyes) -> Channels:
        """The channel of an expression: its weight is the x of a translation."""
        track = self.rig.tracks.get((node, "translation"))
        moved = np.zeros((len(self.times_s), 3)) if track is None else self._kept(track)
        moved[:, 0] = values if track is None else added.mixed(moved[:, 0], values)
        return {(node, "translation"): moved}


def open_gltf_file(
    path: Path, own: Motion, joints: Mapping[str, str] | None = None, animation: str | None = None
) -> GltfFile:
    """Open a file that was read as `own`; `joints` and `animation` as in `read_gltf`.

    Raises InputError (one line) if it has nothing that could be eyes.
    """
    rig = open_rig(path, joints, animation)
    document, buffers = rig.document, rig.document.content["buffers"]
    if len(buffers) != 1 or "uri" in buffers[0]:
        raise InputError(f"{path}: should have one buffer, in the file itself, got {len(buffers)}")
    file = GltfFile(rig, own_times(rig.tracks, own))
    is_vrm = VRM_ANIMATION in document.content.get("extensions", {})
    if not (is_vrm or set(EYES) <= file.rig.joints.keys() or file.face_names()):
        names = [str(node.get("name", "")) for node in document.content["nodes"]]
        raise InputError(
            f"{path}: should have joints or shapes of eyes (LeftEye, eyeBlinkLeft; others by --joint left_eye=NAME), "
            f"got {list_names(names)}"
        )
    return file


def own_times(tracks: Tracks, own: Motion) -> Float[ndarray, " T"]:
    """The times of the frames: those of the track that has a key for each, or even steps from the first key."""
    first = min(float(track.times_s[0]) for track in tracks.values())
    exact = (track.times_s for track in tracks.values() if len(track.times_s) == len(own))
    return np.asarray(next(exact, first + np.arange(len(own)) / own.fps))


def _shapes(motion: Motion, document: GltfDocument, names: list[str], looks: bool) -> dict[str, Float[ndarray, " T"]]:
    """Weights of the shapes of eyes and lids that a face has, by `channel_name`."""
    wanted = {name: values for name, values in eye_channels(motion, names).items() if name in names}
    if LID_SHAPES[0].lower() in names:
        head = head_of(document)
        pose = motion_to_pose(head, motion)
        made = (*LID_SHAPES, *(name for name in arkit.NAMES if name.lower() in wanted))
        return {name.lower(): pose.expression[:, head.shape(name)] for name in made if name.lower() in names}
    return {name: values for name, values in wanted.items() if looks or not name.startswith("eyelook")}


def _is_at(channel: dict[str, Any], node: int, path: str) -> bool:
    return bool(channel["target"].get("node") == node) and channel["target"]["path"] == path


def _root(gltf: Gltf, name: str) -> int:
    """A new node at the root of the scene."""
    node = gltf.node(name)
    gltf.document["scenes"][gltf.document.get("scene", 0)]["nodes"].append(node)
    return node
