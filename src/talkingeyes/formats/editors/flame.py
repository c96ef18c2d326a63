"""Edits FLAME parameters: an npz of named arrays (VHAP, DiffPoseTalk, ours), or UniLS's npy of 108 columns.

Eyes, lids and head are replaced; other arrays keep their bytes. Where a layout has no eyes or lids, `eyes_pose` and
`eyelids` are added. As in our writer, the whole rotation of the head goes to the neck, and the global rotation becomes
0, if the file has both (writers/flame_parameters.py).
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.lib import format as npy

from talkingeyes.core.containers import MAX_ARRAY_BYTES, npz_names, open_zip, read_member, read_npy, read_npz, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import CONVENTIONS, Motion
from talkingeyes.formats.editors.channels import AddedEyes
from talkingeyes.formats.readers.flame_parameters import EYE_KEYS, LID_EXPRESSION, PARAMETER_ALIASES, POSE_KEYS

UNILS_WIDTH = 108
UNILS_HEAD, UNILS_EYES = slice(100, 103), slice(104, 108)  # eyes: x and y of the left, then of the right


@dataclass(frozen=True)
class FlameFile:
    """An npz of parameters: the names of its arrays, the arrays of eyes, lids and head, and the motion as read."""

    path: Path
    names: tuple[str, ...]
    arrays: dict[str, ndarray]
    own: Motion

    @property
    def has_head(self) -> bool:
        return bool(self._head_keys) or POSE_KEYS[0] in self.arrays

    @property
    def _head_keys(self) -> list[str]:
        """Arrays of the head: that of the neck before the global one."""
        found = [[key for key in PARAMETER_ALIASES[part] if key in self.arrays][:1] for part in ("neck", "global")]
        return [key for keys in found for key in keys]

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head."""
        new = self._eyes(added)
        lids = added.motion.lid
        new["eyelids"] = added.mixed(self.own.lid, lids) if "eyelids" in self.arrays else lids
        new |= self._face_without_lids()
        if added.with_head:
            new |= self._head(added.mixed_turns(self.own.head, added.motion.head))
        if added.share == 0:
            new = {name: values for name, values in new.items() if name not in self.arrays}
        kept = {name: self.arrays[name].dtype for name in new if name in self.arrays}
        return _rewritten(self.path, {name: v.astype(kept.get(name, np.float32)) for name, v in new.items()})

    def _eyes(self, added: AddedEyes) -> dict[str, ndarray]:
        key = next((key for key in PARAMETER_ALIASES["eyes"] if key in self.arrays), None)
        pair = all(name in self.arrays for name in EYE_KEYS)
        gaze = added.motion.gaze
        if key or pair:
            both = (added.mixed_turns(self.own.gaze[:, eye], gaze[:, eye]) for eye in range(2))
            gaze = np.stack(list(both), axis=1)
        if pair:
            return {name: gaze[:, eye] for eye, name in enumerate(EYE_KEYS)}
        return {key or PARAMETER_ALIASES["eyes"][0]: gaze.reshape(-1, 6)}

    def _face_without_lids(self) -> dict[str, ndarray]:
        """The expression without its movement of the former lids."""
        if LID_EXPRESSION not in self.arrays:
            return {}
        key = next(key for key in PARAMETER_ALIASES["expression"] if key in self.arrays)
        moved = self.arrays[LID_EXPRESSION]
        return {key: self.arrays[key] - moved, LID_EXPRESSION: np.zeros_like(moved)}

    def _head(self, head: Float[ndarray, "T 3"]) -> dict[str, ndarray]:
        if POSE_KEYS[0] in self.arrays:
            pose = self.arrays[POSE_KEYS[0]].copy().reshape(len(head), -1)
            pose[:, :3] = head
            return {POSE_KEYS[0]: pose}
        first, *others = self._head_keys
        return {first: head, **{key: np.zeros_like(self.arrays[key]) for key in others}}


@dataclass(frozen=True)
class UnilsFile:
    """An array of UniLS. It has no lids."""

    array: Float[ndarray, "*T 108"]
    own: Motion
    has_head: bool = True

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head."""
        array = self.array.copy()
        rows = array.reshape(-1, UNILS_WIDTH)
        if added.share > 0:
            both = [added.mixed_turns(self.own.gaze[:, eye], added.motion.gaze[:, eye]) for eye in range(2)]
            rows[:, UNILS_EYES] = np.concatenate([eye[:, :2] for eye in both], axis=1)
            if added.with_head:
                rows[:, UNILS_HEAD] = added.mixed_turns(self.own.head, added.motion.head)
        return _npy_bytes(array)


def open_flame_npz(path: Path, own: Motion) -> FlameFile:
    """Open an npz that was read as `own` (gaze: forward axes). Raises InputError (one line) for a motion of ours."""
    if str(read_npz(path, ["schema"], "npz").get("schema")) == CONVENTIONS["schema"]:
        raise InputError(
            f"{path}: should be of another program, got a motion; `animate --replace face=` takes its face"
        )
    edited = ("neck", "global", "eyes", "lid", "expression")
    keys = {*POSE_KEYS, *EYE_KEYS, LID_EXPRESSION, *(key for part in edited for key in PARAMETER_ALIASES[part])}
    arrays = {name: array for name, array in read_npz(path, keys, "npz").items() if array.dtype.kind in "fiub"}
    return FlameFile(path, npz_names(path, "npz"), arrays, own)


def open_flame_array(path: Path, own: Motion) -> UnilsFile:
    """Open an npy that was read as `own`. Raises InputError (one line) for layouts without eyes."""
    array = read_npy(path, "npy")
    if array.shape[-1] != UNILS_WIDTH:
        raise InputError(f"{path}: should have eyes, as arrays of width {UNILS_WIDTH} do, got {array.shape}")
    return UnilsFile(array, own)


def _rewritten(path: Path, new: dict[str, ndarray]) -> bytes:
    """The archive with some arrays replaced or added; the others are copied as bytes."""
    out = io.BytesIO()
    with reading(path, "npz"), open_zip(path) as archive, zipfile.ZipFile(out, "w") as copy:
        left = dict(new)
        for info in archive.infolist():
            array = left.pop(info.filename.removesuffix(".npy"), None)
            content = read_member(archive, info, MAX_ARRAY_BYTES) if array is None else _npy_bytes(array)
            copy.writestr(zipfile.ZipInfo(info.filename, info.date_time), content, info.compress_type)
        for name, array in left.items():
            copy.writestr(zipfile.ZipInfo(f"{name}.npy"), _npy_bytes(array), zipfile.ZIP_DEFLATED)
    return out.getvalue()


def _npy_bytes(array: ndarray) -> bytes:
    content = io.BytesIO()
    npy.write_array(content, array, allow_pickle=False)
    return content.getvalue()
