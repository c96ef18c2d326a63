"""Conversion of motion files: `talkingeyes export`, `import` and `animate -f`.

Reads a motion (.npz), the events beside it if there are any, files of other programs (formats/readers/), and the user's
FLAME file where one is needed. Writes one file per motion atomically (formats/writers/). docs/formats.md describes the
formats.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from talkingeyes.animation.line_of_sight import check_forward_axis, to_forward_axes
from talkingeyes.core import output_folder
from talkingeyes.core.atomic_file import writing
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.workflows.render import (
    GAUSSIANS,
    check_look_of,
    check_output_file,
    film,
    load_gaussian_avatar,
    load_head,
    load_shown_head,
    retarget_to_head,
)

if TYPE_CHECKING:
    from talkingeyes.animation.animation import Animation
    from talkingeyes.formats.readers.read_motion import ImportedMotion
    from talkingeyes.head.model import HeadModel

OWN_FILES = re.compile(r".+\.npz")
# Files that `animate` writes beside its motions, skipped where a whole folder is imported.
NO_MOTIONS = re.compile(r"manifest\.json|summary\.(csv|json)|.+\.events\.json")


@dataclass(frozen=True)
class Format:
    """File suffix of a format, and the head model of its expression: `anny`, `flame`, the `chosen` head, or none."""

    suffix: str
    expression: str


FORMATS = {
    "flame": Format(".npz", "flame"),
    "vhap": Format(".npz", "flame"),
    "diffposetalk": Format(".npz", "flame"),
    "livelink": Format(".csv", "anny"),
    "arkit": Format(".json", "anny"),
    "glb": Format(".glb", "chosen"),
    "vrm": Format(".vrma", "anny"),
    "usd": Format(".usda", "chosen"),
    "vocaset": Format(".npy", "chosen"),
    "obj": Format(".obj", "chosen"),
    "ply": Format(".ply", "chosen"),
    "bvh": Format(".bvh", "none"),
    "events": Format(".json", "none"),
    "mp4": Format(".mp4", "chosen"),
}


MESH_FORMATS = ("obj", "ply")  # of one frame
LOOK_FORMATS = ("glb", "mp4")  # that show the open head with a look
ANIMATE_FORMATS = tuple(
    name for name in FORMATS if name not in ("mp4", *MESH_FORMATS)
)  # formats of `animate -f`, which writes videos anyway


@dataclass(frozen=True)
class ImportedFile:
    """An imported motion, as it is read back from its file, and the name of that."""

    name: str
    read: ImportedMotion


def export(
    motion: Path | str | Motion | Animation,
    out: Path | str,
    *,
    format: str | None = None,
    head: str = "anny",
    model: Path | str | None = None,
    fps: float | None = None,
    eyes: str = "visual",
    eyelid: Path | str | None = None,
    look: str | None = None,
    keys: Path | str | None = None,
    sound: Path | str | None = None,
    frame: int | None = None,
    force: bool = False,
) -> Motion:
    """Write a motion (or that of a file) in another format; returns the motion.

    Without `format`, the suffix of `out` selects it, if only one format has this suffix. `head` and `model` are as
    for `render`, gaussians with mp4 and ply (the Gaussians of a frame); the model also maps expressions between the
    open head and FLAME, and moves the lids of vhap. `fps` resamples the motion by its events; `keys` are its edited
    saccades and blinks. `eyes` says what the forward axes of the written eyes are: lines of sight (`visual`, for
    avatars) or optical axes (`optical`, for comparison with photographs). `eyelid` is a person's model
    (`talkingeyes eyelid fit`), for formats that pose a head; `look` that of the open head in glb and mp4. `frame` is
    the frame of a mesh (obj, ply), by default the first.

    Raises InputError (one line) for invalid arguments.
    """
    named = format_of(Path(out)) if format is None else format
    if named not in FORMATS:
        raise InputError(f"format: should be one of {', '.join(FORMATS)}, got {named!r}")
    if sound is not None and named != "mp4":
        raise InputError(f"sound: should be used with mp4 only, got {named}")
    if frame is not None and named not in MESH_FORMATS:
        raise InputError(f"frame: should be used with {' and '.join(MESH_FORMATS)} only, got {named}")
    if eyelid is not None and FORMATS[named].expression != "chosen":
        raise InputError(f"eyelid: should be used with formats that pose a head, got {named}")
    if look is not None and named not in LOOK_FORMATS:
        raise InputError(f"look: should be used with {' and '.join(LOOK_FORMATS)} only, got {named}")
    check_look_of(head, look)
    check_forward_axis(eyes)
    output_path = check_output_file(
        Path(out), FORMATS[named].suffix, force, [Path(motion)] if isinstance(motion, Path | str) else []
    )
    shown, events = _motion_and_events(motion)
    if keys is not None:
        from talkingeyes.animation.event_keys import apply_key_edits, load_keys

        changed = load_keys(Path(keys))
        shown, events = apply_key_edits(shown, changed), changed.current
    if fps is not None:
        from talkingeyes.animation.motion_resampling import resample_motion
        from talkingeyes.formats.writers.event_keys import detect_events

        events = detect_events(shown) if events is None else events
        shown = resample_motion(shown, events, fps)
    if named in MESH_FORMATS:
        shown = _single_frame(shown, frame or 0)
    if named == "mp4":
        return film(shown, output_path, head=head, model=model, sound=sound, eyes=eyes, eyelid=eyelid, look=look)
    with writing(out):
        if named == "ply" and head == GAUSSIANS:
            from talkingeyes.formats.writers.gaussians import write_posed_gaussians

            avatar = load_gaussian_avatar(model, eyelid)
            played = to_forward_axes(retarget_to_head(shown, avatar.head, None), eyes)
            write_posed_gaussians(played, avatar, output_path)
        else:
            write_motion(shown, events, named, output_path, head, model, eyes, eyelid, look)
    return shown


def _single_frame(motion: Motion, frame: int) -> Motion:
    if not 0 <= frame < len(motion):
        raise InputError(f"frame: should be 0 to {len(motion) - 1}, got {frame}")
    return motion.cut(frame, frame + 1)


def format_of(out: Path) -> str:
    """The format of a file's suffix. Raises InputError if there is none, or more than one."""
    found = [name for name, each in FORMATS.items() if each.suffix == out.suffix.lower()]
    if len(found) != 1:
        raise InputError(f"format: should be given for {out.name}, one of {', '.join(found or FORMATS)}, got none")
    return found[0]


def _motion_and_events(motion: Path | str | Motion | Animation) -> tuple[Motion, Events | None]:
    """A motion and its events, if they are known."""
    if isinstance(motion, Motion):
        return motion, None
    if isinstance(motion, Path | str):
        return Motion.load(Path(motion)), _events_beside(Path(motion))
    return motion.motion, motion.events


def write_motion(
    motion: Motion,
    events: Events | None,
    format: str,
    path: Path,
    head: str = "anny",
    model: Path | str | None = None,
    eyes: str = "visual",
    eyelid: Path | str | None = None,
    look: str | None = None,
) -> None:
    """Write a motion in a format other than mp4. `events` become its keys, if they are known."""
    from talkingeyes.formats.writers import arkit, bvh, event_keys, flame_parameters, glb, mesh, usd, vertices, vrm
    from talkingeyes.head.looks import DEFAULT_LOOK

    expression = FORMATS[format].expression
    shown_on = head if expression == "chosen" else "anny"
    shown_file = None if shown_on == "anny" else model
    dressed = format in LOOK_FORMATS
    target_head = (
        load_shown_head(shown_on, shown_file, eyelid, look) if dressed else load_head(shown_on, shown_file, eyelid)
    )
    worn = (look or DEFAULT_LOOK) if dressed and shown_on == "anny" else None
    turned = to_forward_axes(motion, eyes)
    shown = turned if expression == "none" else retarget_expression(turned, expression, target_head, model)
    writers: dict[str, Callable[[], None]] = {
        "flame": lambda: flame_parameters.write_flame(shown, path, eyes),
        "vhap": lambda: flame_parameters.write_vhap(
            shown, path, eyes, None if model is None else load_head("flame", model)
        ),
        "diffposetalk": lambda: flame_parameters.write_diffposetalk(shown, path, eyes),
        "livelink": lambda: arkit.write_live_link(shown, path),
        "arkit": lambda: arkit.write_json(shown, path, eyes),
        "glb": lambda: glb.write_glb(shown, target_head, path, eyes, worn),
        "vrm": lambda: vrm.write_vrm(shown, path, eyes),
        "usd": lambda: usd.write_usd(shown, target_head, path, eyes),
        "vocaset": lambda: vertices.write_vertices(shown, target_head, path),
        "obj": lambda: mesh.write_mesh(shown, target_head, path),
        "ply": lambda: mesh.write_mesh(shown, target_head, path),
        "bvh": lambda: bvh.write_bvh(shown, target_head, path),
        "events": lambda: event_keys.write_keys(motion, path, events),
    }
    writers[format]()


def check_formats(formats: Sequence[str]) -> None:
    """Raises InputError for a format that `animate -f` does not support."""
    for format in formats:
        if format not in ANIMATE_FORMATS:
            raise InputError(f"format: should be one of {', '.join(ANIMATE_FORMATS)}, got {format!r}")


def sibling_name(stem: Path, format: str) -> Path:
    """Name of a file of a format beside the motion: sample_00.flame.npz, sample_00.keys.json, sample_00.glb."""
    suffix = FORMATS[format].suffix
    alone = [name for name in FORMATS if FORMATS[name].suffix == suffix] == [format] and format != "vocaset"
    return stem.with_name(stem.name + ("" if alone else f".{'keys' if format == 'events' else format}") + suffix)


def retarget_expression(motion: Motion, expression: str, target_head: HeadModel, model: Path | str | None) -> Motion:
    """The motion with its expression mapped to the head model of a format."""
    if not motion.expression.any():  # a neutral face is the same on every head
        empty = np.zeros((len(motion), 0))
        return replace(motion, expression=empty, expression_names=(), head_model=target_head.name)
    wanted = target_head.name if expression == "chosen" else expression
    if motion.head_model == wanted:
        return motion
    if model is None:
        raise InputError(
            f"model: should be your FLAME file, which maps the expression of {motion.head_model} to {wanted} "
            "(--flame of animate), got none"
        )
    return retarget_to_head(motion, target_head if wanted == target_head.name else load_head(wanted, model), model)


def import_files(
    files: Sequence[Path | str],
    out: Path | str,
    *,
    fps: float | None = None,
    mapping: Path | str | None = None,
    eyes: str | None = None,
    joints: Mapping[str, str] | None = None,
    animation: str | None = None,
    expression: bool = True,
    force: bool = False,
) -> list[ImportedFile]:
    """Write the motions of external files as Motion files: one as `out`.npz, or any number into a folder.

    `fps` is for files without a frame rate, `mapping` a key map; `eyes` is as for `export`, by default what the format
    usually holds; `joints` and `animation` are names in a GLB, as for `add_eyes`; without
    `expression`, the face is dropped.
    """
    from talkingeyes.core.progress import progress_bar
    from talkingeyes.formats.readers.key_map import load_key_map
    from talkingeyes.formats.readers.read_motion import read_motion

    found = _sources([Path(file) for file in files])
    single = Path(out).suffix == ".npz"
    if single and len(found) > 1:
        raise InputError(f"{out}: should be a folder for {len(found)} files")
    output_path = (
        check_output_file(Path(out), ".npz", force, list(found.values()))
        if single
        else output_folder.output_path(Path(out), OWN_FILES, force)
    )
    if any(path.resolve().is_relative_to(output_path) for path in found.values()) and not single:
        raise InputError(f"{out}: should be another folder than that of the input")
    key_map = None if mapping is None else load_key_map(Path(mapping))
    done = []
    for name, path in progress_bar(found.items(), "import", len(found)):
        read = read_motion(path, fps, key_map, eyes, joints, animation)
        done.append(ImportedFile(name, read if expression else replace(read, motion=_without_face(read.motion))))
    with writing(out, "file" if single else "folder"):
        return _saved(done, output_path, single)


def _saved(done: Sequence[ImportedFile], output_path: Path, single: bool) -> list[ImportedFile]:
    from talkingeyes.core.atomic_file import atomic_write

    if single:
        with atomic_write(output_path) as partial:
            return [_read_back(done[0], partial)]
    with output_folder.atomic_folder(output_path) as folder:
        return [_read_back(each, folder / f"{each.name}.npz") for each in done]


def _read_back(imported: ImportedFile, path: Path) -> ImportedFile:
    imported.read.motion.save(path)
    return replace(imported, read=replace(imported.read, motion=Motion.load(path)))


def _without_face(motion: Motion) -> Motion:
    return replace(
        motion,
        expression=np.zeros((len(motion), 0)),
        expression_names=(),
        head_model="anny",
        jaw=np.zeros_like(motion.jaw),
    )


def _sources(files: Sequence[Path]) -> dict[str, Path]:
    """The files by the names of their motions; a folder is replaced by its files, unless it is a single motion."""
    from talkingeyes.formats.readers.flame_frames import frame_files
    from talkingeyes.formats.readers.read_motion import SUFFIXES

    listed: list[Path] = []
    for file in files:
        if file.is_dir() and not any(file.glob("*.frame")) and not frame_files(file):
            inside = [path for path in sorted(file.iterdir()) if path.name.lower().endswith(SUFFIXES)]
            inside = [path for path in inside if not NO_MOTIONS.fullmatch(path.name)]
            if not inside:
                raise InputError(f"{file}: should hold files that end in {', '.join(SUFFIXES)}, got none")
            listed += inside
        else:
            listed.append(file)
    found: dict[str, Path] = {}
    for path in listed:
        name = next(
            (path.name[: -len(s)] for s in (".csv.gz", path.suffix) if s and path.name.lower().endswith(s)), path.name
        )
        if name in found:
            raise InputError(f"{path}: another file is called {name} too: {found[name]}")
        found[name] = path
    return found


def _events_beside(motion: Path) -> Events | None:
    """Events of a motion, as `animate` wrote them beside it; the original keys, if the file was edited."""
    path = motion.with_name(f"{motion.stem}.events.json")
    if not path.is_file():
        return None
    from talkingeyes.animation.event_keys import load_original

    return load_original(path)
