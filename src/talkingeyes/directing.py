"""What a person asks of a performance, from names and files: the options of `talkingeyes animate`, and `te.direct`.

Reads a track of targets (.json, .csv), the partner's sound, a motion (.npz) whose habits are to be followed.
docs/control.md says what each does.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.errors import InputError
from talkingeyes.performance.direction import Direction, Liveliness

if TYPE_CHECKING:
    from talkingeyes.performance.manner import Manner
    from talkingeyes.performance.targets import TargetTrack

TRACKS = (".json", ".csv")


def direct(
    *,
    blinks: str = "physio",
    target: Path | str | None = None,
    contact: float | None = None,
    head: float = 1.0,
    gaze: float = 1.0,
    blinking: float = 1.0,
    partner: Path | str | None = None,
    style: Path | str | None = None,
) -> Direction:
    """A direction: `target` is camera, listener or a file, `partner` a sound, `style` a speaker's name or a motion.

    `head`, `gaze` and `blinking` are dials: 0 none, 1 as the model, 2 twice.
    Raises InputError (one line) for a mistake.
    """
    return Direction(
        blinks=blinks,
        targets=None if target is None else _track(target),
        contact=contact,
        liveliness=Liveliness(head, gaze, blinking),
        partner=None if partner is None else _heard(partner),
        style=None if style is None else _manner(style),
    )


def _track(target: Path | str) -> TargetTrack:
    from talkingeyes.performance.targets import load_targets, steady

    return load_targets(target) if Path(target).suffix.lower() in TRACKS else steady(str(target))


def _heard(partner: Path | str) -> Float[ndarray, " N"]:
    from talkingeyes.audio.waveform import read_speech

    return read_speech(partner)


def _manner(style: Path | str) -> Manner | str:
    """The habits in a motion, or the name of somebody whose habits the model knows."""
    if Path(style).suffix != ".npz":
        return str(style)
    from talkingeyes.export.keys import found_events
    from talkingeyes.motion import Motion
    from talkingeyes.performance.manner import measured

    motion = Motion.load(Path(style))
    try:
        return measured(motion, 60.0 * len(found_events(motion).blinks) / motion.seconds)
    except InputError as error:
        raise InputError(f"{style}: {error}") from None
