"""`talkingeyes render`, `head` and `avatar`: a motion as a video, a head as a picture, the open head as Gaussians.

Reads a motion (.npz), optionally a sound, and the user's own FLAME file or avatar for these heads. Writes an mp4, a png
or a folder atomically.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from talkingeyes.animation.line_of_sight import check_forward_axis, to_forward_axes
from talkingeyes.core import output_folder
from talkingeyes.core.atomic_file import atomic_write, writing
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.rendering.view import FRAMINGS, Framing

if TYPE_CHECKING:
    from talkingeyes.head.eyelid.model import EyelidModel
    from talkingeyes.head.gaussian_avatar import GaussianAvatar
    from talkingeyes.head.model import HeadModel

HEAD_MODELS = ("anny", "flame")
GAUSSIANS = "gaussians"  # the head of a film or a ply can also be a Gaussian avatar
VIDEO_BOUNDS_PX = (16, 4096)
SHEET_BOUNDS_PX = (170, 8192)
CAMERA_FIELDS: Mapping[str, str] = {  # keys of --camera and their fields of Framing
    "yaw": "yaw_deg",
    "pitch": "pitch_deg",
    "distance": "distance_m",
    "height": "height_m",
}


def render(
    motion: Path | str,
    out: Path | str,
    *,
    head: str = "anny",
    model: Path | str | None = None,
    camera: str = "head",
    sound: Path | str | None = None,
    size: int = 512,
    eyes: str = "visual",
    eyelid: Path | str | None = None,
    look: str | None = None,
    keys: Path | str | None = None,
    force: bool = False,
) -> Motion:
    """Render the motion of a file on a head as a video; returns the rendered motion.

    `head` is anny (the open head), flame with your FLAME file as `model`, or gaussians with the folder of a Gaussian
    avatar (docs/head.md). `keys`: edited saccades and blinks (`talkingeyes export -f events`). `eyelid`: the lids of a
    person (`talkingeyes eyelid fit`). `look`: that of the open head, one of `head.looks.LOOKS`. `eyes`: the pupils
    show the lines of sight (`visual`), so that the head looks at what its motion looks at, or the optical axes
    (`optical`), as in photographs.

    `camera` is a name of FRAMINGS, or numbers (`yaw=30,pitch=10,distance=0.9,height=0.3`), or a name and numbers.
    Angles are in degrees; positive angles move the camera to the subject's left and up. Raises InputError (one line)
    for invalid arguments.
    """
    target = check_output_file(Path(out), ".mp4", force)
    _within("size", size, VIDEO_BOUNDS_PX)
    check_forward_axis(eyes)
    parse_camera(camera).view(size, size)  # validated before anything is read
    shown = Motion.load(Path(motion))
    if keys is not None:
        from talkingeyes.animation.event_keys import apply_key_edits, load_keys

        shown = apply_key_edits(shown, load_keys(Path(keys)))
    return film(
        shown,
        target,
        head=head,
        model=model,
        camera=camera,
        sound=sound,
        size=size,
        eyes=eyes,
        eyelid=eyelid,
        look=look,
    )


def film(
    motion: Motion,
    target: Path,
    *,
    head: str = "anny",
    model: Path | str | None = None,
    camera: str = "head",
    sound: Path | str | None = None,
    size: int = 512,
    eyes: str = "visual",
    eyelid: Path | str | None = None,
    look: str | None = None,
) -> Motion:
    """Render a motion on a head as a video; returns the motion retargeted to the head."""
    from talkingeyes.audio.waveform import read_speech
    from talkingeyes.core.progress import progress_bar
    from talkingeyes.rendering.render import HeadRenderer
    from talkingeyes.rendering.splatting import AvatarRenderer
    from talkingeyes.rendering.video import write_video

    if head not in (*HEAD_MODELS, GAUSSIANS):
        raise InputError(f"head: should be one of {', '.join(HEAD_MODELS)}, {GAUSSIANS}, got {head!r}")
    audio = None if sound is None else read_speech(sound)
    check_look_of(head, look)
    avatar = load_gaussian_avatar(model, eyelid) if head == GAUSSIANS else None
    target_head = load_shown_head(head, model, eyelid, look) if avatar is None else avatar.head
    played = retarget_to_head(motion, target_head, None if avatar else model)
    view = parse_camera(camera).centred_on(target_head.eye_centres).view(size, size)
    renderer = HeadRenderer(target_head, view) if avatar is None else AvatarRenderer(avatar, view)
    pictures = iter(progress_bar(renderer.draw(to_forward_axes(played, eyes)), target.name, len(played)))
    with writing(target):
        write_video(target, pictures, played.fps, audio)
    return played


def render_head_sheet(
    out: Path | str,
    *,
    head: str = "anny",
    model: Path | str | None = None,
    eyelid: Path | str | None = None,
    look: str | None = None,
    size: int = 1400,
    force: bool = False,
) -> None:
    """Write a picture of a head with its eyes in nine directions and its lids at five openings; `size` is its width."""
    from PIL import Image

    from talkingeyes.rendering.contact_sheet import eyes_sheet

    target = check_output_file(Path(out), ".png", force)
    _within("size", size, SHEET_BOUNDS_PX)
    image = Image.fromarray(eyes_sheet(load_shown_head(head, model, eyelid, look), size))
    with writing(out), atomic_write(target) as partial:
        image.save(partial, format="png")


def make_avatar(out: Path | str, *, force: bool = False) -> int:
    """Write a Gaussian avatar of the open head into a folder; returns the number of its Gaussians."""
    from talkingeyes.head.anny import anny_head
    from talkingeyes.head.gaussian_avatar import POINT_CLOUD, save_avatar
    from talkingeyes.rendering import open_avatar

    target = output_folder.output_path(Path(out), re.compile(re.escape(POINT_CLOUD)), force)
    avatar = open_avatar.build_avatar(anny_head())
    with writing(out, "folder"), output_folder.atomic_folder(target) as folder:
        save_avatar(folder, avatar.bound)
    return len(avatar.bound.local)


def parse_camera(camera: str) -> Framing:
    """The framing of a `--camera` argument."""
    framing = FRAMINGS["head"]
    for place, word in enumerate(camera.split(",")):
        name, equals, value = word.strip().partition("=")
        if place == 0 and not equals and name in FRAMINGS:
            framing = FRAMINGS[name]
        elif equals and name in CAMERA_FIELDS:
            changed: dict[str, Any] = {CAMERA_FIELDS[name]: _number(name, value)}
            framing = replace(framing, **changed)
        else:
            known = f"{', '.join(FRAMINGS)}, or {'=, '.join(CAMERA_FIELDS)}="
            raise InputError(f"camera: should be {known}, got {word.strip()!r}")
    if not 0.01 <= framing.height_m <= 2:
        raise InputError(f"camera: height should be 0.01 to 2 m, got {framing.height_m:g}")
    if framing.distance_m <= 0:
        raise InputError(f"camera: distance should be above 0 m, got {framing.distance_m:g}")
    return framing


def load_shown_head(
    head: str = "anny", model: Path | str | None = None, eyelid: Path | str | None = None, look: str | None = None
) -> HeadModel:
    """The head of `load_head` as it is drawn: the open head has a look, by default `head.looks.DEFAULT_LOOK`."""
    check_look_of(head, look)
    if head != "anny" or model is not None:
        return load_head(head, model, eyelid)
    from talkingeyes.head.looks import DEFAULT_LOOK, dressed_head

    return dressed_head(look or DEFAULT_LOOK, None if eyelid is None else _person_lids(eyelid))


def check_look_of(head: str, look: str | None) -> None:
    """Raises InputError for an unknown look, and for a look of another head than the open one."""
    if look is None:
        return
    from talkingeyes.head.looks import check_look

    check_look(look)
    if head != "anny":
        raise InputError(f"look: should be used with the open head (anny), got {head}")


def load_head(head: str, model: Path | str | None, eyelid: Path | str | None = None) -> HeadModel:
    """The open head, or FLAME from the user's own file; with the lids of a person (`talkingeyes eyelid fit`)."""
    return _with_lids(_load_head(head, model), eyelid)


def load_gaussian_avatar(folder: Path | str | None, eyelid: Path | str | None = None) -> GaussianAvatar:
    """A Gaussian avatar from its folder; with the lids of a person. Raises InputError (one line)."""
    from talkingeyes.head.gaussian_avatar import load_avatar

    if folder is None:
        raise InputError(f"model: should be the folder of the avatar where head is {GAUSSIANS}, got none")
    avatar = load_avatar(Path(folder))
    return replace(avatar, head=_with_lids(avatar.head, eyelid))


def _with_lids(head: HeadModel, eyelid: Path | str | None) -> HeadModel:
    if eyelid is None:
        return head
    from talkingeyes.head.eyelid.anatomy import EyelidParameters
    from talkingeyes.head.eyelid.blendshapes import with_eyelids

    return with_eyelids(head, EyelidParameters(), _person_lids(eyelid))


def _person_lids(eyelid: Path | str) -> tuple[EyelidModel, EyelidModel]:
    from talkingeyes.head.eyelid.person import load_person

    left, right = load_person(Path(eyelid)).eyes
    return left.lids, right.lids


def _load_head(head: str, model: Path | str | None) -> HeadModel:
    if head not in HEAD_MODELS:
        raise InputError(f"head: should be one of {', '.join(HEAD_MODELS)}, got {head!r}")
    if (head == "flame") != (model is not None):
        raise InputError("model: should be the FLAME file where head is flame, and only there")
    if model is None:
        from talkingeyes.head.anny import anny_head

        return anny_head()
    from talkingeyes.head.flame import load_flame

    return load_flame(Path(model))


def retarget_to_head(motion: Motion, head: HeadModel, model: Path | str | None) -> Motion:
    """The motion with its expression in the shapes of this head, mapped if it is for the other head model."""
    if all(name in head.expression_names for name in motion.expression_names):
        return motion
    made_for = motion.head_model
    if made_for not in HEAD_MODELS or made_for == head.name or (made_for == "flame" and model is None):
        strange = next(name for name in motion.expression_names if name not in head.expression_names)
        raise InputError(f"motion: expression should be of the head {head.name}, got {strange} (of {made_for})")
    from talkingeyes.head.retarget import expression_map

    return expression_map(load_head(made_for, model if made_for == "flame" else None), head).motion(motion)


def _number(name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"camera: {name} should be a number, got {value!r}")
    return number


def _within(name: str, value: int, bounds: tuple[int, int]) -> None:
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{name}: should be {bounds[0]} to {bounds[1]} pixels, got {value}")


def check_output_file(out: Path, suffix: str, force: bool, inputs: Sequence[Path] = ()) -> Path:
    """Check the output file before any work is done; it is none of `inputs`, even with `force`."""
    if out.suffix != suffix:
        raise InputError(f"{out}: should be a name that ends in {suffix}")
    if out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"{out}: should be a file in a folder that exists")
    if any(out.exists() and each.exists() and out.samefile(each) for each in inputs):
        raise InputError(f"{out}: should be another file than the input")
    if out.exists() and not force:
        raise InputError(f"{out}: should be a new file, got an existing one; overwrite it with --force")
    return out
