"""Motion files of any supported format: choice of the reader, and validation of the result.

.npz  our Motion; VHAP, DiffPoseTalk, FLAME by names      .npy, .pt  EMOTE, ProbTalk3D, ARTalk, UniLS by width
.csv, .csv.gz, .tsv  Live Link Face, OpenFace, py-feat    .frame, or a folder of them  metrical-tracker
.json  ARKit coefficients    .glb .gltf .vrma    .usd .usda .usdc    .bvh    .obj .ply  the open head
.npy .npz by a key map (key_map.py)                        folder with an npz a frame  GaussianAvatars, VHAP
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from talkingeyes.animation.line_of_sight import MEAN_KAPPA_RAD, check_forward_axis, from_forward_axes
from talkingeyes.core import rotation
from talkingeyes.core.containers import read_npz
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import CONVENTIONS, Motion
from talkingeyes.formats.joint_names import check_joints
from talkingeyes.formats.readers import tables
from talkingeyes.formats.readers.flame_frames import frame_files, read_flame_frames
from talkingeyes.formats.readers.forward_axis import default_forward_axis, stated_forward_axis
from talkingeyes.formats.readers.key_map import KeyMap, read_with_map
from talkingeyes.formats.readers.noted import NotedMotion

Reader = Callable[[Path, float | None], Motion | NotedMotion]

SUFFIXES = (
    *(".npz", ".npy", ".pt", ".pth", ".csv", ".csv.gz", ".tsv", ".frame", ".json", ".jsonl"),
    *(".glb", ".gltf", ".vrma", ".usd", ".usda", ".usdc", ".bvh", ".obj", ".ply"),
)
MAX_RAD = {"gaze": 1.4, "head": 3.2, "jaw": 1.2}  # larger values are not radians
LID_BOUNDS = (-1.5, 1.5)
OUTLIER_SHARE = 0.01  # fraction of frames that may exceed the bounds
MAX_DIVERGENCE_DEG = 12.0  # mean; human optical axes diverge by about 9 degrees when lines of sight are parallel
_ASIDE_DEG, _DOWN_DEG = np.degrees(MEAN_KAPPA_RAD[0]) * [1.0, -1.0]
FORWARD_AXIS_NOTES = {
    "visual": f"lines of sight (--eyes visual); optical axes by the mean kappa, {_ASIDE_DEG:.1f} degrees "
    f"to the temple and {_DOWN_DEG:.1f} down",
    "optical": "optical axes (--eyes optical), as in a motion",
}


@dataclass(frozen=True)
class ImportedMotion:
    """A motion, its file format, and notes about it."""

    motion: Motion
    format: str
    notes: tuple[str, ...]


def read_motion(
    path: Path,
    fps: float | None = None,
    mapping: KeyMap | None = None,
    eyes: str | None = None,
    joints: Mapping[str, str] | None = None,
    animation: str | None = None,
) -> ImportedMotion:
    """Read a file of any format, and check units and eyes. `fps` is for files without a frame rate.

    `eyes` says what the forward axes of the eyes in the file are: lines of sight (`visual`) or optical axes
    (`optical`); by default what the file states, or what its format usually holds. `joints` are the names of joints of
    a GLB, by left_eye, right_eye, head, neck and jaw, `animation` is the name of one of its animations.
    """
    if fps is not None and not 1 <= fps <= 1000:
        raise InputError(f"fps: should be 1 to 1000, got {fps:g}")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    name, reader = ("map", partial(_mapped, mapping)) if mapping is not None else _reader(path)
    if joints or animation is not None:
        if name != "gltf":
            option = "joint" if joints else "animation"
            raise InputError(f"{path}: {option}: should be used with GLB, got {name}")
        from talkingeyes.formats.readers.gltf import read_gltf

        reader = partial(read_gltf, joints=check_joints(joints or {}), animation=animation)
    try:
        with np.errstate(all="ignore"):  # values are checked
            read = reader(path, fps)
            motion, said = (read.motion, read.notes) if isinstance(read, NotedMotion) else (read, ())
            forward_axis = check_forward_axis(eyes or default_forward_axis(path, name))
            notes = [*said, *check_motion(path, motion)]
            if motion.gaze.any():
                stated = eyes is None and bool(stated_forward_axis(path, name))
                notes.append(f"eyes {'stated' if stated else 'taken'} as {FORWARD_AXIS_NOTES[forward_axis]}")
            motion = from_forward_axes(motion, forward_axis)
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except Exception as error:  # a damaged file can raise anything in a reader
        raise InputError(f"{path}: not readable as {name} ({error!r})") from None
    return ImportedMotion(motion, name, tuple(notes))


def _mapped(mapping: KeyMap, path: Path, fps: float | None) -> Motion:
    return read_with_map(path, mapping, fps)


def check_motion(path: Path, motion: Motion) -> list[str]:
    """Notes on a motion. Raises InputError if its values are out of range."""
    if not len(motion):
        raise InputError(f"{path}: should have frames, got none")
    for name, most in MAX_RAD.items():
        angle = np.linalg.norm(getattr(motion, name), axis=-1).reshape(-1)
        typical = float(np.quantile(angle, 1 - OUTLIER_SHARE))
        if typical > most:
            hint = "; if these are degrees, set unit: degrees in a map" if typical > 3.2 else ""
            raise InputError(f"{path}: {name} should rotate by at most {most:g} radians, got {typical:.3g}{hint}")
    low, high = np.quantile(motion.lid, [OUTLIER_SHARE, 1 - OUTLIER_SHARE])
    if low < LID_BOUNDS[0] or high > LID_BOUNDS[1]:
        raise InputError(f"{path}: lids should be 0 open to 1 shut, got {low:.3g} to {high:.3g}")
    notes = []
    yaw = np.degrees(rotation.gaze_to_angles(motion.gaze)[motion.valid][..., 0])
    apart = float((yaw[:, 0] - yaw[:, 1]).mean()) if len(yaw) else 0.0
    if abs(apart) > MAX_DIVERGENCE_DEG:
        notes.append(
            f"the left eye looks {apart:.1f} degrees left of the right one on average; check the order of the eyes"
        )
    if not motion.valid.all():
        notes.append(f"{np.count_nonzero(~motion.valid)} of {len(motion)} frames have no face: filled in, not valid")
    if not motion.gaze.any():
        notes.append("no gaze in the file: the eyes look straight ahead")
    return notes


def _reader(path: Path) -> tuple[str, Reader]:
    """Format and reader of a file."""
    from talkingeyes.formats.readers import arkit_json, bvh, flame_parameters, gltf, mesh, metrical, usd

    name = path.name.lower()
    if path.is_dir() and frame_files(path):
        return "flame", read_flame_frames
    if path.is_dir() or name.endswith(".frame"):
        return "metrical-tracker", metrical.read_metrical
    if name.endswith((".csv", ".csv.gz", ".tsv")):
        return _table_reader(path)
    by_suffix: dict[str, tuple[str, Reader]] = {
        **dict.fromkeys((".json", ".jsonl"), ("arkit", arkit_json.read_arkit_json)),
        ".bvh": ("bvh", bvh.read_bvh),
        ".npy": ("flame array", flame_parameters.read_flame_array),
        ".npz": ("flame", _read_npz),
        **dict.fromkeys((".pt", ".pth"), ("flame array", flame_parameters.read_flame_array)),
        **dict.fromkeys((".glb", ".gltf", ".vrma"), ("gltf", gltf.read_gltf)),
        **dict.fromkeys((".obj", ".ply"), ("mesh", mesh.read_mesh)),
        **dict.fromkeys((".usd", ".usda", ".usdc"), ("usd", usd.read_usd)),
    }
    if path.suffix.lower() not in by_suffix:
        raise InputError(f"{path}: should end in one of {', '.join(SUFFIXES)}, or be read with --map")
    return by_suffix[path.suffix.lower()]


def _table_reader(path: Path) -> tuple[str, Reader]:
    from talkingeyes.formats.readers.live_link import read_live_link
    from talkingeyes.formats.readers.trackers import read_openface_motion, read_pyfeat

    names = [column.lower() for column in tables.read(path).names]
    if "gaze_angle_x" in names:
        return "openface", read_openface_motion
    if "facescore" in names and "gaze_yaw" in names:
        return "py-feat", read_pyfeat
    return "livelink", read_live_link


def _read_npz(path: Path, fps: float | None) -> Motion | NotedMotion:
    from talkingeyes.formats.readers.flame_parameters import read_flame_npz

    ours = str(read_npz(path, ["schema"], "npz").get("schema")) == CONVENTIONS["schema"]
    return Motion.load(path) if ours else read_flame_npz(path, fps)
