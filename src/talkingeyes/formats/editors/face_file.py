"""A file of another program, opened for new eyes: the editor of its format, by its ending and content.

.csv, .csv.gz, .tsv  table.py      .json  json_text.py      .glb, .vrma  gltf.py      .npz, .npy  flame.py
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, runtime_checkable

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.core.atomic_file import temporary_folder
from talkingeyes.core.containers import reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.formats.editors import flame, gltf, json_text, table
from talkingeyes.formats.editors.channels import AddedEyes
from talkingeyes.formats.readers.forward_axis import default_forward_axis
from talkingeyes.formats.readers.read_motion import ImportedMotion, read_motion

SUFFIXES = (".csv", ".csv.gz", ".tsv", ".json", ".jsonl", ".glb", ".vrma", ".npz", ".npy")


@runtime_checkable
class Editor(Protocol):
    """What an editor does: it says whether its file has a head, and writes eyes and head into a copy of the file."""

    @property
    def has_head(self) -> bool: ...

    def edited(self, added: AddedEyes) -> bytes: ...


@dataclass(frozen=True)
class FaceFile:
    """A file with its editor.

    `motion` is what it holds (gaze: optical axes), `format` the name of its format, and `forward_axis` what the forward
    axes of its eyes are: `visual` or `optical`. `reader` reads files like it; `notes` say which part of it is edited.
    """

    path: Path
    format: str
    motion: Motion
    forward_axis: str
    editor: Editor
    reader: Callable[[Path], ImportedMotion]
    notes: tuple[str, ...] = ()

    def read_back(self, content: bytes) -> Motion:
        """What readers see in the edited file. Raises InputError (one line) if they cannot read it."""
        with temporary_folder() as folder:
            copy = folder / self.path.name
            copy.write_bytes(content)
            try:
                return self.reader(copy).motion
            except InputError as error:
                said = str(error).replace(str(copy), "the edited file")
                raise InputError(f"{self.path}: {said}") from None


def open_face_file(
    path: Path,
    fps: float | None = None,
    eyes: str | None = None,
    joints: Mapping[str, str] | None = None,
    animation: str | None = None,
) -> FaceFile:
    """Open a file for new eyes. `fps`, `eyes`, `joints` and `animation` are as in `read_motion`.

    Raises InputError (one line) for a file that cannot be read, or has no place for eyes.
    """
    if not path.name.lower().endswith(SUFFIXES):
        raise InputError(f"{path}: should end in one of {', '.join(SUFFIXES)}")
    reader = partial(read_motion, fps=fps, eyes=eyes, joints=joints, animation=animation)
    read = reader(path)
    forward_axis = eyes or default_forward_axis(path, read.format)
    own = to_forward_axes(read.motion, forward_axis)
    editors: dict[str, Callable[[], Editor]] = {
        "flame": lambda: flame.open_flame_npz(path, own),
        "flame array": lambda: flame.open_flame_array(path, own),
        "arkit": lambda: json_text.open_json(path, fps),
        "gltf": lambda: gltf.open_gltf_file(path, own, joints, animation),
    }
    with reading(path, f"{read.format} file that can be edited"):
        editor = editors.get(read.format, lambda: table.open_table(path, read.format, fps))()
    notes = editor.rig.notes if isinstance(editor, gltf.GltfFile) else ()
    return FaceFile(path, read.format, read.motion, forward_axis, editor, reader, notes)
