"""`talkingeyes add-eyes` and `talkingeyes.add_eyes`: our eyes and head in a file of another program.

Reads a file of face motion (formats/editors/) and the speech. Writes the file again, atomically, in its own format,
with its frame rate and its length; what is not of eyes, lids and head keeps its bytes (docs/add_eyes.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.controls import Controls
from talkingeyes.animation.line_of_sight import check_forward_axis, to_forward_axes
from talkingeyes.audio.waveform import SAMPLE_RATE, SHORTEST_S
from talkingeyes.core.atomic_file import atomic_write, writing
from talkingeyes.core.containers import reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import ARRAY_FIELDS, Events, Motion
from talkingeyes.workflows.animate import (
    DEFAULT_CONTROLS,
    AnimationOptions,
    Speech,
    load_performer,
    load_speech,
    sample_animations,
)
from talkingeyes.workflows.render import check_output_file

if TYPE_CHECKING:
    from talkingeyes.animation.animation import Animation
    from talkingeyes.animation.animator import Animator
    from talkingeyes.formats.editors.face_file import FaceFile


@dataclass(frozen=True)
class EyeOptions:
    """Options of `add_eyes` that concern the eyes, not the files."""

    seed: int = 0
    controls: Controls = DEFAULT_CONTROLS
    keep_head: bool = False
    blend: float = 1.0

    def __post_init__(self) -> None:
        """Raises InputError (one line) for a blend out of bounds."""
        if not 0.0 <= self.blend <= 1.0:
            raise InputError(f"blend: should be 0 (the file's eyes) to 1 (ours), got {self.blend:g}")


@dataclass(frozen=True)
class EyesAdded:
    """What was written: the format, the sampled animation (a frame for each of the file), and notes about both.

    `events` are the saccades and blinks that are detected in the written file, read again.
    """

    format: str
    animation: Animation
    events: Events
    notes: tuple[str, ...]


def add_eyes(
    face: Path | str,
    speech: Speech,
    out: Path | str,
    *,
    seed: int = 0,
    fps: float | None = None,
    model: Path | str | None = None,
    controls: Controls = DEFAULT_CONTROLS,
    keep_head: bool = False,
    blend: float = 1.0,
    eyes: str | None = None,
    joints: Mapping[str, str] | None = None,
    animation: str | None = None,
    force: bool = False,
) -> EyesAdded:
    """Put gaze, vergence, lids, blinks and head motion, sampled for speech, into a copy of a file of another program.

    `keep_head` keeps the head of the file; the eyes then move on it, with gaze in space as sampled. `blend` is the
    share of ours in channels that the file has: 0 keeps them and adds what is missing, 1 replaces them. `fps` is for
    files that do not say their rate; `eyes` says what the forward axes of the eyes are (`export`), by default what the
    file states or its format usually has; `joints` are names of joints of a GLB (left_eye, right_eye, head, neck, jaw),
    by default those that are found; `animation` is the name of one of its animations, by default the first that moves
    the face. Other options are those of `animate`.

    Raises InputError (one line) for invalid arguments, and files that have no place for eyes.
    """
    from talkingeyes.formats.editors.face_file import open_face_file

    path = Path(face)
    options = EyeOptions(seed, controls, keep_head, blend)
    if eyes is not None:
        check_forward_axis(eyes)
    output_path = check_output_file(Path(out), path.suffix, force)
    file = open_face_file(path, fps, eyes, joints, animation)
    content, added = edit_face(file, load_speech(speech), load_performer(model), options)
    with writing(out), atomic_write(output_path) as partial:
        partial.write_bytes(content)
    return added


def edit_face(
    file: FaceFile, sound: Float[ndarray, " N"], performer: Animator, options: EyeOptions
) -> tuple[bytes, EyesAdded]:
    """The content of a file with eyes for a sound of 16 kHz. Raises InputError as `add_eyes` does."""
    from talkingeyes.formats.editors.channels import AddedEyes
    from talkingeyes.formats.writers.event_keys import detect_events

    frames, has_head, rate = len(file.motion), file.editor.has_head, file.motion.fps
    with_head = has_head and not options.keep_head
    notes = (*file.notes, *_notes(len(sound) / SAMPLE_RATE, file.motion, has_head))
    steps = math.ceil(file.motion.seconds * performer.fps - 1e-6)  # frames of the model, which cover the file
    samples = math.ceil(steps / performer.fps * SAMPLE_RATE)
    fitted = np.pad(sound[:samples], (0, max(samples - len(sound), 0)))
    controls = _with_head_of(file.motion, options.controls, with_head, has_head)
    asked = AnimationOptions(samples=1, seed=options.seed, fps=rate, controls=controls)
    sampled = sample_animations(performer, fitted, asked)[0]
    animation = replace(sampled, motion=sampled.motion.cut(0, frames))
    shown = to_forward_axes(animation.motion, file.forward_axis)
    with reading(file.path, f"{file.format} file that can be edited"):
        content = file.editor.edited(AddedEyes(shown, with_head, options.blend))
    written = file.read_back(content)
    if options.blend > 0 and not (written.gaze.any() or written.lid.any()):
        notes += ("no eyes are read in the written file: its readers know no place for them",)
    elif options.blend > 0 and shown.gaze.any() and not written.gaze.any():
        notes += ("no place for gaze in the file: no saccades",)
    elif options.blend > 0 and shown.lid.any() and not written.lid.any():
        notes += ("no place for lids in the file: no blinks",)
    return content, EyesAdded(file.format, animation, detect_events(written), notes)


def _notes(speech_s: float, motion: Motion, has_head: bool) -> tuple[str, ...]:
    """What is said about a speech of another length (by a frame or more), frames without a face, and no head."""
    if motion.seconds < SHORTEST_S:
        raise InputError(f"face: should last at least {SHORTEST_S} s, got {motion.seconds:.3f} s")
    notes: tuple[str, ...] = ()
    if abs(speech_s - motion.seconds) >= 1 / motion.fps:
        done = "cut the speech" if speech_s > motion.seconds else "padded the speech with silence"
        notes = (f"the speech lasts {speech_s:.2f} s, the file {motion.seconds:.2f} s: {done}",)
    if not motion.valid.all():
        notes += (f"{np.count_nonzero(~motion.valid)} of {len(motion)} frames have no face in the file, and no eyes",)
    head = "the head of the file" if motion.head.any() else "a still head"
    return notes if has_head else (*notes, f"no place for the head in the file: the eyes move in {head}")


def _with_head_of(motion: Motion, controls: Controls, with_head: bool, has_head: bool) -> Controls:
    """Controls under which the eyes move on the head that the file will have."""
    if with_head:
        return controls
    parts = controls.parts
    if not has_head and not motion.head.any():
        return replace(controls, parts=replace(parts, disabled=tuple(dict.fromkeys((*parts.disabled, "head")))))
    rows = np.minimum(np.arange(len(motion) + math.ceil(motion.fps)), len(motion) - 1)  # the last frame is held
    held = replace(motion, **{name: getattr(motion, name)[rows] for name in ARRAY_FIELDS})
    return replace(controls, parts=replace(parts, replacements={**parts.replacements, "head": held}))
