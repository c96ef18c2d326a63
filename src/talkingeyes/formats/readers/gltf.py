"""glTF files with the animation of a head: GLB (or .gltf) with joints and morph targets, and VRM animations (.vrma).

Joints are found as in gltf_rig.py, weights by the names of the targets, of all meshes. Where lids are driven by the
shapes of the Eyelid model, closure is computed from the weight of its blink shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats import arkit
from talkingeyes.formats.joint_names import list_names
from talkingeyes.formats.readers.flame_parameters import EXPRESSION
from talkingeyes.formats.readers.forward_axis import LOOK_KEY
from talkingeyes.formats.readers.gltf_document import GltfDocument, Track, Tracks
from talkingeyes.formats.readers.gltf_rig import VRM_ANIMATION, Rig, open_rig
from talkingeyes.formats.readers.noted import NotedMotion, no_place_note
from talkingeyes.formats.shape_names import EYE_EQUIVALENTS, arkit_shapes, shape_names
from talkingeyes.head.anny import anny_head
from talkingeyes.head.anny_build import JAW_OPEN_RAD
from talkingeyes.head.eyelid.blendshapes import LID_SHAPES, eyelid_weights
from talkingeyes.head.looks import LOOKS, dressed_head
from talkingeyes.head.model import HeadModel

EXPRESSIONS = tuple(map(EXPRESSION.format, range(100)))  # of FLAME
VRM_PLACED = ("blinkLeft", "blinkRight", "blink", "aa", *arkit.NAMES, *EYE_EQUIVALENTS)
MAX_FRAMES = 1_000_000  # 4.6 hours at 60 frames per second


def read_gltf(
    path: Path, fps: float | None = None, joints: Mapping[str, str] | None = None, animation: str | None = None
) -> NotedMotion:
    """Read the motion of a .glb, .gltf or .vrma.

    `joints` are names of nodes by joint, where the file's own are unknown; `animation` is the name of one of several.
    Raises InputError (one line) if it holds no animation of a head.
    """
    with reading(path, "GLB with an animation"):
        rig = open_rig(path, joints, animation)
        is_vrm = VRM_ANIMATION in rig.document.content.get("extensions", {})
        read = _vrm(rig, fps) if is_vrm else _head(rig, fps)
        return replace(read, notes=(*rig.notes, *read.notes))


def _head(rig: Rig, fps: float | None) -> NotedMotion:
    document, tracks = rig.document, rig.tracks
    names = [str(node.get("name", "")) for node in document.content["nodes"]]
    faces = {node: shapes for node, shapes in document.shapes(tracks).items() if (node, "weights") in tracks}
    if not rig.face_tracks:
        raise _nothing_known(document, tracks, names)
    rate, times = frame_grid(rig.face_tracks, fps)
    root = tracks.get((names.index("root"), "translation")) if "root" in names else None
    place = document.content["nodes"][names.index("root")].get("translation", [0, 0, 0]) if root else [0, 0, 0]
    shift = np.zeros((len(times), 3)) if root is None else root.sampled(times) - np.array(place)
    gaze = np.stack([rig.turns("left_eye", times), rig.turns("right_eye", times)], axis=1)
    shapes: dict[str, ndarray] = {}
    for node, shown in faces.items():  # teeth and lashes repeat shapes of the face, not always animated
        for name, values in zip(shown, tracks[node, "weights"].sampled(times).T, strict=True):
            if name not in shapes or not shapes[name].any():
                shapes[name] = values
    turns = rig.turns("head", times), gaze, rig.turns("jaw", times)
    motion = motion_from_shapes(rate, *turns, shift, shapes, head_of(document))
    notes = lost_shapes(shapes)
    unnamed = [track for (node, path), track in tracks.items() if path == "weights" and node not in faces]
    if unnamed:
        notes += (f"{sum(each.values.shape[1] for each in unnamed)} shapes without names have no place here",)
    return NotedMotion(motion, notes)


def head_of(document: GltfDocument) -> HeadModel:
    """The open head that a file shows: with the look that it states, on which the weights of its lids depend."""
    look = (document.content["asset"].get("extras") or {}).get(LOOK_KEY)
    return dressed_head(look) if look in LOOKS else anny_head()


def _nothing_known(document: GltfDocument, tracks: Tracks, names: Sequence[str]) -> InputError:
    unnamed = next((track for (_, path), track in tracks.items() if path == "weights"), None)
    if unnamed is not None:
        return InputError(
            f"{document.path}: should name its shapes (targetNames in the extras of the mesh or of its primitives), "
            f"got {unnamed.values.shape[1]} without names"
        )
    return InputError(
        f"{document.path}: should animate shapes or joints (Head, LeftEye, ...; --joint left_eye=NAME names others), "
        f"got {list_names(names)}"
    )


def lost_shapes(shapes: Mapping[str, ndarray]) -> tuple[str, ...]:
    """The note on shapes that move and have no place in a motion."""
    placed = EXPRESSIONS if EXPRESSIONS[0] in shapes else (*arkit.NAMES, *EYE_EQUIVALENTS, *LID_SHAPES)
    return no_place_note([name for name in shapes if shapes[name].any() and name not in placed], len(shapes))


def motion_from_shapes(
    fps: float,
    head: ndarray,
    gaze: ndarray,
    jaw: ndarray,
    shift: ndarray,
    shapes: dict[str, ndarray],
    posed: HeadModel | None = None,
) -> Motion:
    """Build a motion from joint rotations and the weights of shapes by standard name.

    `posed` is the head that the weights of its lids are for, by default the open head.
    """
    shapes = arkit_shapes(shapes)
    if EXPRESSIONS[0] in shapes:  # FLAME, which has no lid shapes
        names = tuple(name for name in EXPRESSIONS if name in shapes)
        made_for, lid = "flame", np.zeros((len(head), 2))
        expression = np.stack([shapes[name] for name in names], axis=1)
    else:
        table = np.stack([shapes.get(name, np.zeros(len(head))) for name in arkit.NAMES], axis=1)
        by_shape = arkit.decoded(table)
        names, made_for, lid = arkit.EXPRESSION, "anny", by_shape.lid
        jaw = jaw if jaw.any() else by_shape.jaw
        expression = by_shape.expression
        if "lidBlinkLeft" in shapes:
            whole = eyelid_weights(posed or anny_head(), gaze, np.ones((len(head), 2)))
            both = [
                shapes[f"lidBlink{side}"] / np.maximum(whole[f"lidBlink{side}"], 1e-6) for side in ("Left", "Right")
            ]
            lid = np.stack(both, axis=1)
            wide = [arkit.EXPRESSION.index(f"eyeWide{side}") for side in ("Left", "Right")]
            expression[:, wide] = table[:, [arkit.NAMES.index(f"eyeWide{side}") for side in ("Left", "Right")]]
        elif not gaze.any():
            gaze = by_shape.gaze
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


def _vrm(rig: Rig, fps: float | None) -> NotedMotion:
    tracks, content = rig.tracks, rig.document.content["extensions"][VRM_ANIMATION]
    expressions = content.get("expressions", {})
    custom = expressions.get("custom", {})
    known_as = dict(zip(custom, shape_names(list(custom)), strict=True))  # ARKit's names, which avatars may have too
    shown = {**{known_as[name]: place for name, place in custom.items()}, **expressions.get("preset", {})}
    looking = tracks.get((content["lookAt"]["node"], "rotation")) if "lookAt" in content else None
    weights = {name: tracks.get((place["node"], "translation")) for name, place in shown.items()}
    turning = [tracks[key] for key in rig.keys("head")]
    known = [track for track in (looking, *turning, *weights.values()) if track is not None]
    if not known:
        raise InputError(f"{rig.document.path}: should animate the head, the look-at or expressions, got none")
    rate, times = frame_grid(known, fps)

    def weight(*names: str) -> ndarray:
        track = next((weights[name] for name in names if weights.get(name) is not None), None)
        return np.zeros(len(times)) if track is None else track.sampled(times)[:, 0]

    jaw = np.zeros((len(times), 3))
    jaw[:, 0] = JAW_OPEN_RAD * weight("aa")
    shapes = {name: weight(name) for name in (*arkit.NAMES, *EYE_EQUIVALENTS) if weights.get(name) is not None}
    looks = np.zeros((len(times), 3)) if looking is None else looking.rotations(times).as_rotvec()
    gaze = np.repeat(looks[:, None], 2, axis=1)
    lid = np.stack([weight("blinkLeft", "blink"), weight("blinkRight", "blink")], axis=1)
    moving = [name for name, track in weights.items() if track is not None and track.values[:, 0].any()]
    lost = no_place_note([name for name in moving if name not in VRM_PLACED], len(shown), "expressions")
    head = rig.turns("head", times)
    if not shapes:
        return NotedMotion(Motion.of(rate, head, gaze, lid=lid, jaw=jaw), lost)
    motion = motion_from_shapes(rate, head, gaze, jaw, np.zeros((len(times), 3)), shapes)
    return NotedMotion(motion if motion.lid.any() else replace(motion, lid=lid), lost)


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
