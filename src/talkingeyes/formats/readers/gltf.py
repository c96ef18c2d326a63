"""glTF files with the animation of a head: GLB with joints and morph targets, and VRM animations (.vrma).

Joints are found by name (neck or head; jaw; left_eye or LeftEye; ...), weights by the names of the targets. Where lids
are driven by the shapes of the Eyelid model, closure is computed from the weight of its blink shape.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from talkingeyes.core.containers import MAX_ARRAY_BYTES, parse_json, read_bytes
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.readers.flame_parameters import EXPRESSION
from talkingeyes.formats.rotations import compose_rotations
from talkingeyes.head.anny import anny_head
from talkingeyes.head.anny_build import JAW_OPEN_RAD
from talkingeyes.head.eyelid.blendshapes import eyelid_weights

DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
JOINT_ALIASES = {  # our names and their aliases; the first animated one is used
    "head": ("neck", "head", "Head", "Neck"),
    "jaw": ("jaw", "Jaw"),
    "left_eye": ("left_eye", "leftEye", "LeftEye", "eyeLeft"),
    "right_eye": ("right_eye", "rightEye", "RightEye", "eyeRight"),
}
VRM_EXTENSION = "VRMC_vrm_animation"
MAX_FRAMES = 1_000_000  # 4.6 hours at 60 frames per second


@dataclass(frozen=True)
class Track:
    """Keyframes of one node."""

    times_s: Float[ndarray, " K"]
    values: Float[ndarray, "K C"]


@dataclass(frozen=True)
class RestRotation:
    """The rotation of a node at rest: that of its parent in the file's axes, and its own in its parent.

    Rigs of other programs have bones with axes of their own, so a turn of the head about the file's axes is another
    rotation in the axes of the bone.
    """

    parent: Rotation
    own: Rotation

    def to_file_axes(self, local: Rotation) -> Rotation:
        """The turn from rest, about the file's axes, of a rotation of the node."""
        return self.parent * local * self.own.inv() * self.parent.inv()

    def from_file_axes(self, turn: Rotation) -> Rotation:
        """The inverse of `to_file_axes`."""
        return self.parent.inv() * turn * self.parent * self.own


AT_REST = RestRotation(Rotation.identity(), Rotation.identity())


@dataclass(frozen=True)
class GltfDocument:
    """The JSON of a file and its binary buffer."""

    path: Path
    content: dict[str, Any]
    binary: bytes

    def array(self, index: int) -> Float[ndarray, "N C"]:
        """Values of a dense accessor."""
        accessor = self.content["accessors"][index]
        dtype, width = np.dtype(DTYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        view = self.content["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        if view.get("byteStride", 0) not in (0, dtype.itemsize * width):
            raise InputError(f"{self.path}: animation data should not be interleaved")
        flat = np.frombuffer(self.binary, dtype, accessor["count"] * width, start).astype(np.float64)
        return flat.reshape(-1, width)

    def tracks(self) -> dict[tuple[int, str], Track]:
        """Channels of the first animation, by node and path."""
        animation = self.content["animations"][0]
        found, left = {}, MAX_ARRAY_BYTES  # many channels can name one accessor
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            if sampler.get("interpolation", "LINEAR") == "CUBICSPLINE":
                raise InputError(f"{self.path}: animation should be LINEAR or STEP, got CUBICSPLINE")
            times = self.array(sampler["input"])[:, 0]
            target = channel["target"]
            values = self.array(sampler["output"]).reshape(len(times), -1)
            found[target["node"], target["path"]] = Track(times, values)
            left -= times.nbytes + values.nbytes
            if left < 0:
                raise InputError(f"{self.path}: animation should have at most {MAX_ARRAY_BYTES:,} bytes of keys")
        return found

    def animated_joints(self, tracks: dict[tuple[int, str], Track]) -> dict[str, int | None]:
        """Nodes that turn head, jaw and eyes, by our names."""
        return {
            ours: next((node for node in self.named_nodes(theirs) if (node, "rotation") in tracks), None)
            for ours, theirs in JOINT_ALIASES.items()
        }

    def named_nodes(self, names: tuple[str, ...]) -> list[int]:
        """The nodes of these names, in the order of the names."""
        found = [node.get("name", "") for node in self.content["nodes"]]
        return [found.index(name) for name in names if name in found]

    def turns(
        self, tracks: dict[tuple[int, str], Track], node: int | None, times: Float[ndarray, " T"]
    ) -> Float[ndarray, "T 3"]:
        """Rotation vectors of a node from rest, about the axes of the file; 0 if it is not animated."""
        track = None if node is None else tracks.get((node, "rotation"))
        if node is None or track is None:
            return np.zeros((len(times), 3))
        return turns(track, times, self.rest_rotation(node))

    def rest_rotation(self, node: int) -> RestRotation:
        """The rotation of a node at rest. Raises InputError if the nodes are not a tree."""
        nodes = self.content["nodes"]
        parents = {child: index for index, each in enumerate(nodes) for child in each.get("children", ())}
        above, place, steps = Rotation.identity(), parents.get(node), 0
        while place is not None:
            above, place, steps = _own_rotation(nodes[place]) * above, parents.get(place), steps + 1
            if steps > len(nodes):
                raise InputError(f"{self.path}: nodes should form a tree")
        return RestRotation(above, _own_rotation(nodes[node]))


def _own_rotation(node: dict[str, Any]) -> Rotation:
    if "matrix" in node:
        axes = np.array(node["matrix"], np.float64).reshape(4, 4).T[:3, :3]
        return Rotation.from_matrix(axes / np.linalg.norm(axes, axis=0))
    return Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0)))


def read_gltf(path: Path, fps: float | None = None) -> Motion:
    """Read the motion of a .glb or .vrma. Raises InputError if it holds no animation of a head."""
    try:
        document = open_gltf(path)
        tracks = document.tracks()
        return (
            _vrm(document, tracks, fps)
            if VRM_EXTENSION in document.content.get("extensions", {})
            else _head(document, tracks, fps)
        )
    except (OSError, KeyError, IndexError, TypeError, ValueError, struct.error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a GLB with an animation ({error!r})") from None


def open_gltf(path: Path) -> GltfDocument:
    """Open a binary glTF 2.0 file. Raises InputError (one line) for anything else."""
    data = read_bytes(path)
    if data[:8] != b"glTF" + struct.pack("<I", 2) or len(data) < 28:
        raise InputError(f"{path}: should be a binary glTF 2.0 file (.glb, .vrma)")
    length = struct.unpack_from("<I", data, 12)[0]
    return GltfDocument(path, parse_json(data[20 : 20 + length]), data[20 + length + 8 :])


def _head(document: GltfDocument, tracks: dict[tuple[int, str], Track], fps: float | None) -> Motion:
    names = [node.get("name", "") for node in document.content["nodes"]]
    joints = document.animated_joints(tracks)
    weights = next(((node, track) for (node, path), track in tracks.items() if path == "weights"), None)
    known = [tracks[node, "rotation"] for node in joints.values() if node is not None]
    known += [weights[1]] if weights else []
    if not known:
        raise InputError(
            f"{document.path}: should animate a joint such as {', '.join(JOINT_ALIASES)}, got {', '.join(names[:6])}"
        )
    rate, times = frame_grid(known, fps)
    turned = {ours: document.turns(tracks, node, times) for ours, node in joints.items()}
    shapes: dict[str, ndarray] = {}
    if weights is not None:
        mesh = document.content["meshes"][document.content["nodes"][weights[0]]["mesh"]]
        targets = mesh.get("extras", {}).get("targetNames", [])
        shapes = dict(zip(targets, sampled(weights[1], times).T, strict=True))
    root = tracks.get((names.index("root"), "translation")) if "root" in names else None
    place = document.content["nodes"][names.index("root")].get("translation", [0, 0, 0]) if root else [0, 0, 0]
    shift = np.zeros((len(times), 3)) if root is None else sampled(root, times) - np.array(place)
    gaze = np.stack([turned["left_eye"], turned["right_eye"]], axis=1)
    return motion_from_shapes(rate, turned["head"], gaze, turned["jaw"], shift, shapes)


def motion_from_shapes(
    fps: float, head: ndarray, gaze: ndarray, jaw: ndarray, shift: ndarray, shapes: dict[str, ndarray]
) -> Motion:
    """Build a motion from joint rotations and named shape weights."""
    if "expression_000" in shapes:  # FLAME, which has no lid shapes
        names = tuple(name for name in (EXPRESSION.format(k) for k in range(100)) if name in shapes)
        made_for, lid = "flame", np.zeros((len(head), 2))
        expression = np.stack([shapes[name] for name in names], axis=1)
    else:
        table = np.stack([shapes.get(name, np.zeros(len(head))) for name in arkit.NAMES], axis=1)
        by_shape = arkit.decoded(table)
        names, made_for, lid = arkit.EXPRESSION, "anny", by_shape.lid
        jaw = jaw if jaw.any() else by_shape.jaw
        expression = by_shape.expression
        if "lidBlinkLeft" in shapes:
            whole = eyelid_weights(anny_head(), gaze, np.ones((len(head), 2)))
            both = [
                shapes[f"lidBlink{side}"] / np.maximum(whole[f"lidBlink{side}"], 1e-6) for side in ("Left", "Right")
            ]
            lid = np.stack(both, axis=1)
            wide = [arkit.EXPRESSION.index(f"eyeWide{side}") for side in ("Left", "Right")]
            expression[:, wide] = table[:, [arkit.NAMES.index(f"eyeWide{side}") for side in ("Left", "Right")]]
    return Motion.of(
        fps,
        head,
        gaze,
        translation=shift,
        lid=lid,
        jaw=jaw,
        expression=expression,
        expression_names=names,
        head_model=made_for,
    )


def _vrm(document: GltfDocument, tracks: dict[tuple[int, str], Track], fps: float | None) -> Motion:
    content = document.content["extensions"][VRM_EXTENSION]
    bones, shown = content["humanoid"]["humanBones"], content.get("expressions", {}).get("preset", {})
    nodes = {name: bones[name]["node"] for name in ("head", "neck") if name in bones}
    turning = [tracks.get((node, "rotation")) for node in nodes.values()]
    looking = tracks.get((content["lookAt"]["node"], "rotation")) if "lookAt" in content else None
    weights = {name: tracks.get((place["node"], "translation")) for name, place in shown.items()}
    known = [track for track in (looking, *turning, *weights.values()) if track is not None]
    if not known:
        raise InputError(f"{document.path}: should animate the head, the look-at or expressions, got none")
    rate, times = frame_grid(known, fps)
    neck, skull = (document.turns(tracks, nodes.get(name), times) for name in ("neck", "head"))
    head = compose_rotations(neck, skull)

    def weight(*names: str) -> ndarray:
        track = next((weights[name] for name in names if weights.get(name) is not None), None)
        return np.zeros(len(times)) if track is None else sampled(track, times)[:, 0]

    jaw = np.zeros((len(times), 3))
    jaw[:, 0] = JAW_OPEN_RAD * weight("aa")
    looks = np.zeros((len(times), 3)) if looking is None else turns(looking, times)
    gaze = np.repeat(looks[:, None], 2, axis=1)
    lid = np.stack([weight("blinkLeft", "blink"), weight("blinkRight", "blink")], axis=1)
    return Motion.of(rate, head, gaze, lid=lid, jaw=jaw)


def count_frames(span_s: float, fps: float) -> int:
    """Number of frames in a time span. Raises InputError for more than MAX_FRAMES."""
    if not 0 <= span_s * fps < MAX_FRAMES:
        raise InputError(f"animation: should have at most {MAX_FRAMES:,} frames, got {span_s:g} s at {fps:g} fps")
    return round(span_s * fps) + 1


def frame_grid(tracks: Sequence[Track], fps: float | None) -> tuple[float, Float[ndarray, " T"]]:
    """Frame rate (of the track with most keys, unless given) and frame times.

    Exporters write two keys for what does not move.
    """
    track = max(tracks, key=lambda each: len(each.times_s))
    steps = np.diff(track.times_s)
    if fps is None and (not len(steps) or np.ptp(steps) > 0.1 * np.median(steps)):
        raise InputError("animation: keys should be evenly spaced, got uneven ones; set --fps")
    span = float(track.times_s[-1] - track.times_s[0])
    rate = fps if fps is not None else round(len(steps) / span, 3)
    frames = count_frames(span, rate)
    return rate, track.times_s[0] + np.arange(frames) / rate


def sampled(track: Track, times: Float[ndarray, " T"]) -> Float[ndarray, "T C"]:
    """Values of a track at times, linearly interpolated."""
    return np.stack([np.interp(times, track.times_s, column) for column in track.values.T], axis=1)


def turns(track: Track, times: Float[ndarray, " T"], rest: RestRotation = AT_REST) -> Float[ndarray, "T 3"]:
    """Rotation vectors of a track of quaternions, from rest about the file's axes, with spherical interpolation."""
    keys = rest.to_file_axes(Rotation.from_quat(track.values))
    if len(track.times_s) == 1:
        return np.repeat(keys.as_rotvec(), len(times), axis=0)
    return np.asarray(Slerp(track.times_s, keys)(np.clip(times, track.times_s[0], track.times_s[-1])).as_rotvec())
