"""Controls of an animation besides sound, samples, seed and frame rate (docs/control.md).

`animation/pipeline.py` applies them; `workflows/direct.py` reads them from options and files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.conversation_states import AUTO, StateTrack
from talkingeyes.animation.listening_behaviour import FACE_TO_FACE, check_population
from talkingeyes.animation.part_overrides import NO_OVERRIDES, PartOverrides
from talkingeyes.animation.targets import TargetTrack
from talkingeyes.core.errors import InputError
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.models.face.style import FaceStyle, StyleKey

MAX_LIVELINESS = 3.0
NEUTRAL_FACE = (StyleKey(0.0, FaceStyle(None, "neutral", 0)),)


@dataclass(frozen=True)
class Liveliness:
    """Scale of the motion: 0 none, 1 as sampled, 2 double.

    `head` scales rotation about the mean pose, `gaze` the distance of gaze from its median, `blinks` the blink rate.
    """

    head: float = 1.0
    gaze: float = 1.0
    blinks: float = 1.0


@dataclass(frozen=True)
class Controls:
    """Controls of an animation; a control left at its default leaves the model's motion as it is.

    `blinks`: the blink profile (physiological, paper or corpus). `targets`: what gaze goes to and when. `eye_contact`:
    the fraction of time with gaze at the listener (0 to 1; None: as sampled). `partner`: the sound (16 kHz) of the
    conversation partner. `population`: whose gaze while listening (face_to_face, remote_call). `states`: when the
    subject speaks, listens, thinks or is idle, as a track or (`auto`) from the sounds. `person`: the training speaker
    that the model is conditioned on (None: a random one by the
    seed). `style`: a training speaker's name or measured motion statistics, which are imposed. `no_postprocessing`:
    head and gaze as sampled, without head contribution, amplitude limit and saccadic intrusions (to compare models).
    `face`: the styles of the face (emotion, intensity, speaker) with their onsets; head, gaze and blinks follow the
    emotion. `parts`: which parts are replaced or
    switched off.
    """

    blinks: str = "physiological"
    targets: TargetTrack | None = None
    eye_contact: float | None = None
    liveliness: Liveliness = Liveliness()
    partner: Float[ndarray, " N"] | None = None
    population: str = FACE_TO_FACE
    states: StateTrack | str | None = None
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
        check_population(self.population)
        if not self.face:
            raise InputError("face: should have at least one style, got none")
        if isinstance(self.states, str) and self.states != AUTO:
            raise InputError(f"states: should be {AUTO} or a track, got {self.states}")
        if self.partner is not None and not np.isfinite(self.partner).all():
            raise InputError("partner: should be a sound of finite samples, got NaN or infinite ones")
