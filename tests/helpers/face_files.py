"""Files of face motion as other programs write them: lips, jaw and brows that move, eyes that do not.

Layouts: Live Link Face's CSV; Audio2Face's JSON, with its own names and with ARKit's; the CSV of Audio2Face-3D's
client; LAM Audio2Expression's JSON; FLAME parameters of VHAP, DiffPoseTalk and UniLS; an avatar as GLB, whose bones
have axes of their own; lips as VRM animation.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from talkingeyes.formats import arkit
from talkingeyes.formats.writers.arkit import timecode
from talkingeyes.formats.writers.gltf import Gltf

_A2F = """browLowerL browLowerR innerBrowRaiserL innerBrowRaiserR outerBrowRaiserL outerBrowRaiserR eyesLookLeft
eyesLookRight eyesLookUp eyesLookDown eyesCloseL eyesCloseR eyesUpperLidRaiserL eyesUpperLidRaiserR squintL squintR
cheekRaiserL cheekRaiserR cheekPuffL cheekPuffR noseWrinklerL noseWrinklerR jawDrop jawDropLipTowards jawThrust
jawSlideLeft jawSlideRight mouthSlideLeft mouthSlideRight dimplerL dimplerR lipCornerPullerL lipCornerPullerR
lipCornerDepressorL lipCornerDepressorR lipStretcherL lipStretcherR upperLipRaiserL upperLipRaiserR lowerLipDepressorL
lowerLipDepressorR chinRaiser lipPressor pucker funneler lipSuck"""
A2F_NAMES = _A2F.split()
HEAD_RAD = 0.1  # amplitude of the head where a file has one
# Rest rotations of bones, as rigs have them: y along the bone, turned about it.
SPINE, HEAD, EYE = (
    Rotation.from_euler("xyz", angles, degrees=True) for angles in ((8, 0, 0), (-20, 15, 0), (90, 0, 30))
)


def weights(frames: int, columns: int, seed: int = 0) -> np.ndarray:
    """Smooth weights from 0 to 1, with digits that no writer of ours would give them."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames)[:, None] / 25
    return np.asarray(0.5 + 0.5 * np.sin(2 * np.pi * times * rng.uniform(0.3, 3, columns) + rng.uniform(0, 6, columns)))


def is_eye(name: str) -> bool:
    """Whether a name is that of a channel of eyes or lids (cheekSquint is none)."""
    plain = name.rpartition(".")[2].lower()
    return plain.startswith(("eye", "lefteye", "righteye", "squint"))


def live_link(path: Path, fps: float = 60.0, frames: int = 180) -> Path:
    """A take with CRLF line ends, a dropped frame, columns in another order, and a head that turns."""
    names = [*reversed([name[0].upper() + name[1:] for name in arkit.NAMES]), *arkit.ANGLES]
    table = weights(frames, len(names))
    for column, name in enumerate(names):
        if name.startswith("Head"):
            table[:, column] = HEAD_RAD * (table[:, column] - 0.5)
        elif is_eye(name):
            table[:, column] = 0.0
    lines = [",".join(["Timecode", "BlendShapeCount", *names, "Note"])]
    for frame, row in enumerate(table):
        if frame != 33:
            cells = [timecode(frame, fps), "61", *(f"{value:.12g}" for value in row), '"a, b"']
            lines.append(",".join(cells))
    path.write_bytes("\r\n".join([*lines, ""]).encode())
    return path


def audio2face_json(path: Path, fps: float = 30.0, frames: int = 75, names: list[str] | None = None) -> Path:
    """An export of Audio2Face, indented; its joints are not of the eyes."""
    names = A2F_NAMES if names is None else names
    table = weights(frames, len(names))
    table[:, [is_eye(name) for name in names]] = 0
    content = {
        "exportFps": fps,
        "trackPath": 'C:/voices/a "b" 1.5.wav',
        "numPoses": len(names),
        "numFrames": frames,
        "facsNames": names,
        "weightMat": [[0 if value == 0 else float(f"{value:.9g}") for value in row] for row in table],
        "joints": ["jaw"],
        "rotations": [[[0, 0, 0, 1]]] * frames,
        "translations": [[[0.0, 0.0, 1e-3]]] * frames,
    }
    path.write_text(json.dumps(content, indent=2))
    return path


def audio2face_csv(path: Path, fps: float = 30.0, frames: int = 75) -> Path:
    """`animation_frames.csv` of Audio2Face-3D's client, as pandas writes it; eyes look ahead, the head is still.

    The header is that of a published file (walkoncross/NIM-audio2face-visualization on GitHub).
    """
    names = [name[0].upper() + name[1:] for name in arkit.NAMES] + ["HeadRoll", "HeadPitch", "HeadYaw"]
    table = weights(frames, len(names)).astype(np.float32)
    table[:, [name.startswith(("EyeLook", "Head")) for name in names]] = 0
    lines = [",".join(["", "timeCode", *(f"blendShapes.{name}" for name in names)])]
    lines += [",".join([str(k), repr(k / fps), *(repr(float(v)) for v in row)]) for k, row in enumerate(table)]
    path.write_text("\n".join(lines) + "\n")
    return path


def lam_json(path: Path, fps: float = 30.0, frames: int = 75) -> Path:
    """An export of LAM Audio2Expression."""
    table = weights(frames, len(arkit.NAMES))
    content = {
        "names": list(arkit.NAMES),
        "metadata": {"fps": fps, "frame_count": frames, "blendshape_names": list(arkit.NAMES)},
        "frames": [{"weights": row.tolist(), "time": k / fps, "rotation": []} for k, row in enumerate(table)],
    }
    path.write_text(json.dumps(content))
    return path


def vhap(path: Path, frames: int = 75) -> Path:
    """Parameters of VHAP, with a frame rate beside."""
    rng = np.random.default_rng(3)
    turned = HEAD_RAD * (weights(frames, 15) - 0.5).astype(np.float32)
    np.savez(
        path,
        rotation=turned[:, :3],
        neck_pose=turned[:, 3:6],
        jaw_pose=turned[:, 6:9],
        eyes_pose=turned[:, 9:15],
        expr=rng.normal(size=(frames, 100)).astype(np.float32),
        shape=rng.normal(size=300).astype(np.float32),
        translation=np.zeros((frames, 3), np.float32),
        timestep_id=np.arange(frames),
        fps=np.float64(25),
    )
    return path


def diffposetalk(path: Path, frames: int = 75) -> Path:
    """Parameters of DiffPoseTalk, without eyes and without a frame rate."""
    rng = np.random.default_rng(4)
    pose = HEAD_RAD * (weights(frames, 6) - 0.5)
    np.savez_compressed(path, shape=rng.normal(size=100), exp=rng.normal(size=(frames, 50)), pose=pose)
    return path


def unils(path: Path, frames: int = 75) -> Path:
    """An array of UniLS."""
    np.save(path, (HEAD_RAD * (weights(frames, 108) - 0.5)).astype(np.float32))
    return path


def avatar_glb(path: Path, fps: float = 30.0, frames: int = 75, eye_shapes: bool = True, lids: bool = True) -> Path:
    """An avatar whose lips move: bones with axes of their own, a face and teeth with shapes.

    The bones of the eyes and of the head have the keys that converters write for bones that do not move: as many as
    others, or two.
    """
    gltf = Gltf()
    bones = {"Spine": SPINE, "Head": HEAD, "LeftEye": EYE, "RightEye": EYE}
    for index, (name, turn) in enumerate(bones.items()):
        children = {0: [1], 1: [2, 3]}.get(index, [])
        gltf.node(name, rotation=turn.as_quat().tolist(), **({"children": children} if children else {}))
    left_out = [part for part, kept in (("eyeLook", eye_shapes), ("eyeBlink", lids), ("eyeWide", lids)) if not kept]
    names = [name for name in arkit.NAMES if not name.startswith(tuple(left_out))]
    point = np.zeros((3, 3), np.float32)
    for part, shapes in (("Face", names), ("Teeth", ["jawOpen", "tongueOut"])):
        targets = [{"POSITION": gltf.sparse_accessor(point)} for _ in shapes]
        primitive = {"attributes": {"POSITION": gltf.accessor(point)}, "targets": targets}
        mesh = gltf.add("meshes", {"primitives": [primitive], "extras": {"targetNames": shapes}})
        gltf.node(part, mesh=mesh, skin=0)
    gltf.add("skins", {"joints": [0, 1, 2, 3]})
    gltf.document["scenes"][0]["nodes"] = [0, 4, 5]
    still = np.tile(EYE.as_quat(), (frames, 1))
    lips = weights(frames, len(names))
    lips[:, [is_eye(name) for name in names]] = 0
    keys = {(2, "rotation"): still, (3, "rotation"): still, (4, "weights"): lips, (5, "weights"): weights(frames, 2, 1)}
    gltf.animate(keys, fps)
    animation = gltf.document["animations"][0]
    ends = gltf.accessor(np.array([0, (frames - 1) / fps], np.float32))
    animation["channels"].append({"sampler": len(keys), "target": {"node": 1, "path": "rotation"}})
    animation["samplers"].append({"input": ends, "output": gltf.keys("rotation", np.tile(HEAD.as_quat(), (2, 1)))})
    gltf.save(path)
    return path


def lips_vrma(path: Path, fps: float = 30.0, frames: int = 75, custom: tuple[str, ...] = ()) -> Path:
    """A VRM animation of a mouth and a neck alone: no look-at, no blinks; `custom` are expressions that stay at 0."""
    gltf = Gltf()
    for index, name in enumerate(("hips", "neck", "head", "aa", "ih")):
        gltf.node(name, **({"children": [index + 1]} if index < 2 else {}))
    gltf.document["scenes"][0]["nodes"] = [0, 3, 4]
    mouth = weights(frames, 6)
    neck = Rotation.from_rotvec(HEAD_RAD * (weights(frames, 3) - 0.5)).as_quat()
    keys = {(1, "rotation"): neck, (3, "translation"): mouth[:, :3], (4, "translation"): mouth[:, 3:]}
    own = {name: {"node": gltf.node(name)} for name in custom}
    gltf.document["scenes"][0]["nodes"] += [each["node"] for each in own.values()]
    gltf.animate(keys | {(each["node"], "translation"): np.zeros((frames, 3)) for each in own.values()}, fps)
    gltf.document["extensionsUsed"] = ["VRMC_vrm_animation"]
    gltf.document["extensions"] = {
        "VRMC_vrm_animation": {
            "specVersion": "1.0",
            "humanoid": {"humanBones": {name: {"node": node} for node, name in enumerate(("hips", "neck", "head"))}},
            "expressions": {"preset": {"aa": {"node": 3}, "ih": {"node": 4}}, "custom": own},
        }
    }
    gltf.save(path)
    return path


# Each layout: the file's name, the function that writes it, and its frame rate if it does not state one.
LAYOUTS: dict[str, tuple[str, Callable[[Path], Path], float | None]] = {
    "live link": ("take.csv", live_link, None),
    "audio2face": ("a2f.json", audio2face_json, None),
    "audio2face-3d": ("animation_frames.csv", audio2face_csv, None),
    "lam": ("bsData.json", lam_json, None),
    "vhap": ("tracked.npz", vhap, None),
    "diffposetalk": ("sample.npz", diffposetalk, 25.0),
    "unils": ("motion.npy", unils, 25.0),
    "avatar": ("avatar.glb", avatar_glb, None),
    "vrm": ("lips.vrma", lips_vrma, None),
}
