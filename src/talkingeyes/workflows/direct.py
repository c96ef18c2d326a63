"""What a person asks of a performance, from names and files: the options of `talkingeyes animate`, and `te.direct`.

Reads a track of targets (.json, .csv), the partner's sound, motions (.npz) whose habits are to be followed or that
take the place of a part. docs/control.md says what each does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.direction import Direction, Liveliness
from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    from talkingeyes.animation.targets import TargetTrack
    from talkingeyes.fitting.manner import Manner

TRACKS = (".json", ".csv")
USUAL_INTENSITY = 2


def direct(
    *,
    blinks: str = "physio",
    target: Path | str | None = None,
    contact: float | None = None,
    head: float = 1.0,
    gaze: float = 1.0,
    blinking: float = 1.0,
    partner: Path | str | None = None,
    person: str | None = None,
    style: Path | str | None = None,
    as_drawn: bool = False,
    emotion: str = "neutral",
    intensity: int | None = None,
    speaker: str | None = None,
    without: Sequence[str] = (),
    replaced: Mapping[str, Path | str] = MappingProxyType({}),
) -> Direction:
    """A direction: `target` is camera, listener or a file, `partner` a sound, `style` a speaker's name or a motion.

    `person` is who moves, a speaker whom the model knows; by default one of them, drawn by the seed.
    `head`, `gaze` and `blinking` are dials: 0 none, 1 as the model, 2 twice. `as_drawn`: nothing is laid over the
    model's head and gaze but what is asked (docs/whole.md). `emotion`, `intensity` (1 to 3) and
    `speaker` are of the face. Parts (head, gaze, blinks, face) are switched off by `without`, or taken from motions.
    Raises InputError (one line) for a mistake.
    """
    from talkingeyes.animation.parts import Parts
    from talkingeyes.core.motion import Motion
    from talkingeyes.models.face.style import Style, StyleKey

    return Direction(
        blinks=blinks,
        targets=None if target is None else _track(target),
        contact=contact,
        liveliness=Liveliness(head, gaze, blinking),
        partner=None if partner is None else _heard(partner),
        person=person,
        style=None if style is None else _manner(style),
        as_drawn=as_drawn,
        face=(StyleKey(0.0, Style(speaker, emotion, strength(emotion, intensity))),),
        parts=Parts(tuple(without), {part: Motion.load(Path(path)) for part, path in replaced.items()}),
    )


def strength(emotion: str, intensity: int | None) -> int:
    """The intensity of an emotion, which need not be said."""
    if intensity is not None:
        return intensity
    return 0 if emotion == "neutral" else USUAL_INTENSITY


def _track(target: Path | str) -> TargetTrack:
    from talkingeyes.animation.targets import load_targets, steady

    return load_targets(target) if Path(target).suffix.lower() in TRACKS else steady(str(target))


def _heard(partner: Path | str) -> Float[ndarray, " N"]:
    from talkingeyes.audio.waveform import read_speech

    return read_speech(partner)


def _manner(style: Path | str) -> Manner | str:
    """The habits in a motion, or the name of somebody whose habits the model knows."""
    if Path(style).suffix != ".npz":
        return str(style)
    from talkingeyes.animation.manner import manner_of
    from talkingeyes.core.motion import Motion

    motion = Motion.load(Path(style))
    try:
        return manner_of(motion)
    except InputError as error:
        raise InputError(f"{style}: {error}") from None
