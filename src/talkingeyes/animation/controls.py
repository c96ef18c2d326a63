"""What a person asks of a performance besides sound, samples, seed and frame rate (docs/control.md).

Everything left as it is, is the model's own. `performance.perform` follows it; files are read by `targets`, `manner`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.part_overrides import NO_OVERRIDES, PartOverrides
from talkingeyes.animation.targets import TargetTrack
from talkingeyes.core.errors import InputError
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.models.face.style import FaceStyle, StyleKey

MAX_LIVELINESS = 3.0
NEUTRAL_FACE = (StyleKey(0.0, FaceStyle(None, "neutral", 0)),)


@dataclass(frozen=True)
class Liveliness:
    """How much of the model's motion there is: 0 none, 1 as it is, 2 twice as much.

    `head` scales how far it turns from its mean pose, `gaze` how far gaze goes from its usual place, `blinks` how often
    they come.
    """

    head: float = 1.0
    gaze: float = 1.0
    blinks: float = 1.0


@dataclass(frozen=True)
class Controls:
    """What is asked for.

    `blinks` names the profile of their rate (physiological, paper or corpus), `targets` what gaze goes to and when,
    `eye_contact` the share of time that gaze is at the listener (0 to 1; None: as the model does), `partner` the sound
    (16 kHz) of whom the subject talks with, `person` who moves, of the speakers whom the model was told in training
    (None: one of them, by the seed), `style` whose habits are imposed: a speaker kept with the model, or measured ones.
    `no_postprocessing`: head and gaze are the model's alone, without what performance.oculomotor adds (to compare
    models). `face` is the style of the face from moments on (emotion, intensity, speaker), `parts` what is replaced or
    off.
    """

    blinks: str = "physiological"
    targets: TargetTrack | None = None
    eye_contact: float | None = None
    liveliness: Liveliness = Liveliness()
    partner: Float[ndarray, " N"] | None = None
    person: str | None = None
    style: MotionStyle | str | None = None
    no_postprocessing: bool = False
    face: tuple[StyleKey, ...] = NEUTRAL_FACE
    parts: PartOverrides = NO_OVERRIDES

    def __post_init__(self) -> None:
        """Raises InputError (one line) for a number out of bounds."""
        if self.eye_contact is not None and not 0.0 <= self.eye_contact <= 1.0:
            raise InputError(
                f"eye_contact: should be 0 (gaze averted) to 1 (at the listener), got {self.eye_contact:g}"
            )
        for each in fields(Liveliness):
            value = getattr(self.liveliness, each.name)
            if not (math.isfinite(value) and 0.0 <= value <= MAX_LIVELINESS):
                raise InputError(f"liveliness of {each.name}: should be 0 (none) to {MAX_LIVELINESS:g}, got {value:g}")
        if not self.face:
            raise InputError("face: should have at least one style, got none")
        if self.partner is not None and not np.isfinite(self.partner).all():
            raise InputError("partner: should be a sound of finite samples, got NaN or infinite ones")
