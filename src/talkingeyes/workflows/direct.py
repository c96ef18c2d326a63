"""Controls of an animation from names and files: the options of `talkingeyes animate`, and `te.make_controls`.

Reads tracks of targets (.json, .csv), the partner's sound, and motions (.npz) as style references or as replacements of
parts. docs/control.md describes each control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.conversation_states import AUTO, StateTrack, load_states
from talkingeyes.animation.listening_behaviour import FACE_TO_FACE
from talkingeyes.animation.motion_resampling import resample_motion
from talkingeyes.animation.part_overrides import PartOverrides
from talkingeyes.animation.targets import TargetTrack, constant_target, load_targets
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Events, Motion
from talkingeyes.fitting.motion_style import MotionStyle, measure_style
from talkingeyes.models.face.style import FaceStyle, StyleKey, default_intensity

TRACK_SUFFIXES = (".json", ".csv")
STYLE_FPS = 25.0  # frame rate at which saccades are counted


def make_controls(
    *,
    blinks: str = "physiological",
    target: Path | str | None = None,
    eye_contact: float | None = None,
    head: float = 1.0,
    gaze: float = 1.0,
    blinking: float = 1.0,
    partner: Path | str | None = None,
    population: str = FACE_TO_FACE,
    states: Path | str | None = None,
    person: str | None = None,
    style: Path | str | None = None,
    no_postprocessing: bool = False,
    emotion: str = "neutral",
    intensity: int | None = None,
    speaker: str | None = None,
    without: Sequence[str] = (),
    replaced: Mapping[str, Path | str] = MappingProxyType({}),
) -> Controls:
    """Controls of an animation: `target` is camera, listener or a file, `partner` a sound, `states` auto or a file.

    `population` is whose gaze while listening (face_to_face, remote_call), `style` a speaker's name or a motion.
    `person` is a training speaker of the model; by default a random one, chosen by the seed. `head`, `gaze` and
    `blinking` are factors of liveliness: 0 none, 1 as the model, 2 double. `no_postprocessing` switches the rule-based
    layers off, apart from the chosen controls (docs/whole.md). `emotion` and `intensity` (1 to 3) concern face and
    blinks, and head and gaze if their model is conditioned on the emotion; `speaker` concerns the face. Parts (head,
    gaze, blinks, face) are switched off by `without`, or replaced by those of other motions.

    Raises InputError (one line) for invalid arguments.
    """
    return Controls(
        blinks=blinks,
        targets=None if target is None else _track(target),
        eye_contact=eye_contact,
        liveliness=Liveliness(head, gaze, blinking),
        partner=None if partner is None else read_speech(partner),
        population=population,
        states=None if states is None else _states(states),
        person=person,
        style=None if style is None else _motion_style(style),
        no_postprocessing=no_postprocessing,
        face=(StyleKey(0.0, FaceStyle(speaker, emotion, default_intensity(emotion, intensity))),),
        parts=PartOverrides(tuple(without), {part: Motion.load(Path(path)) for part, path in replaced.items()}),
    )


def _track(target: Path | str) -> TargetTrack:
    return load_targets(target) if Path(target).suffix.lower() in TRACK_SUFFIXES else constant_target(str(target))


def _states(states: Path | str) -> StateTrack | str:
    return AUTO if str(states) == AUTO else load_states(states)


def _motion_style(style: Path | str) -> MotionStyle | str:
    """The style of a motion, or the name of a speaker whose style the model contains."""
    if Path(style).suffix != ".npz":
        return str(style)
    motion = Motion.load(Path(style))
    try:
        return measure_clip_style(motion)
    except InputError as error:
        raise InputError(f"{style}: {error}") from None


def measure_clip_style(clip: Motion) -> MotionStyle:
    """The style of a reference clip of any frame rate; saccades are counted at 25 frames a second, as the model's."""
    return measure_style(resample_motion(clip, Events(), STYLE_FPS))
