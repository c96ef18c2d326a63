"""One take: everything a speaker does while saying one sound, from that speaker's style and the take's own randomness.

The sound enters only through its annotation, and only through coin tosses: takes of one sound differ in all but jaw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core import rotation
from talkingeyes.core.motion import Blink, Events, Motion, Refocus, Saccade
from talkingeyes.physiology import blinks, face, render
from talkingeyes.physiology.articulation import MouthHabit
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.physiology.render import Continuous, Waves
from talkingeyes.synthesis import affect, gestures
from talkingeyes.synthesis.brows import draw_brow_raises
from talkingeyes.synthesis.conversation import WARM_UP_S, Look, looks
from talkingeyes.synthesis.looking import look_around
from talkingeyes.synthesis.speakers import Style

LID_UNREST_RAD = np.radians(1.2)  # with a memory of half a second, up to 5 degrees; the eyes differ by a part of it
LID_UNREST_HZ, LID_WAVES, LID_DIFFERENCE_RAD = (0.04, 1.6), 12, 0.35
MOOD_TIDE, MOOD_HZ = 0.2, (0.05, 0.3)
# How much rarer blinks are in shifts back to the partner: suppressed towards what matters (Williamson 2005). FACTS' .4
# would leave shifts of 20 to 30 degrees, most of them ways back, far below Evinger's share of blinks.
TOWARDS_PARTNER = 0.85
EVOKED_FULL = 0.5
LEAST_SPONTANEOUS = 0.25
HEAD_GRID_S = 0.08
BLINK_LAG_S, LONGEST_BLINK_LAG_S = 0.004, 0.010


@dataclass(frozen=True)
class Take:
    """A performance of one sound: rendered at any frame rate by `render.render`. `looks` are its gaze states."""

    events: Events
    continuous: Continuous
    looks: tuple[Look, ...]

    def motion(self, fps: float, frames: int) -> Motion:
        """Frames 0 to `frames` at `fps`."""
        return render.render_at(self.events, self.continuous, fps, frames)


def perform(
    annotation: Annotation, style: Style, seconds: float, random: np.random.Generator, profile: BlinkProfile
) -> Take:
    """Draw a take of a sound that is `seconds` long, in the emotion that it is said in."""
    style = affect.moved(style, annotation.emotion, _share(annotation, style))
    continuous = _continuous(annotation, style, seconds, random)
    gestured = [
        move
        for gesture in (gestures.posture_shifts, gestures.nods, gestures.leaning, gestures.backchannels)
        for move in gesture(annotation, style, random)
    ]
    head_s = np.arange(-WARM_UP_S, seconds + HEAD_GRID_S, HEAD_GRID_S)
    head = render.head(Events(head_moves=tuple(gestured)), continuous, head_s)
    states = looks(annotation, style, seconds, random)
    looking = look_around(states, style, head_s, rotation.angles_of_direction(rotation.directions(head)), random)
    shifts = tuple(each for each in looking.saccades if each.onset_s < seconds)
    moves = sorted(gestured + looking.head_moves, key=lambda move: move.onset_s)
    past = [move for move in moves if move.onset_s + move.duration_s <= 0]
    present = [move for move in moves if move.onset_s + move.duration_s > 0 and move.onset_s < seconds]
    seen = tuple(each for each in shifts if each.onset_s + each.duration_s > 0)
    events = Events(
        saccades=seen,
        refocuses=_from_the_start(looking.refocuses, seconds),
        head_moves=tuple(present),
        blinks=_blinks(annotation, style, seconds, seen, looking.partner_rad, random, profile),
    )
    continuous = replace(
        continuous,
        gaze_rest_rad=shifts[-1].end_rad,
        head_rest=continuous.head_rest + np.sum([move.delta_rad for move in past], axis=0),
    )
    return Take(events, continuous, tuple(look for look in states if look.end_s > 0))


def _from_the_start(refocuses: Sequence[Refocus], seconds: float) -> tuple[Refocus, ...]:
    """What the eyes are set to from time 0 on: the last change before it, and those that follow."""
    before = max((index for index, each in enumerate(refocuses) if each.onset_s <= 0), default=0)
    return tuple(each for each in refocuses[before:] if each.onset_s < seconds)


def _continuous(annotation: Annotation, style: Style, seconds: float, random: np.random.Generator) -> Continuous:
    posture = np.array([style.rest_pitch, 0.0, style.rest_roll]) + np.radians(0.7) * random.standard_normal(3)
    drift, *speaking = (gestures.unrest(band, style, random) for band in gestures.BANDS.values())
    return Continuous(
        gaze_rest_rad=(0.0, 0.0),
        kappa_rad=np.array(style.kappa),
        head_rest=posture,
        head_waves=drift,
        head_speaking=gestures.joined(*speaking),
        activity=gestures.activity(annotation, random),
        translation=gestures.translation(style, random),
        eyelids=style.eyelids,
        lid_rest=style.lid_rest,
        lid_unrest=_lid_unrest(random),
        blink_lag_s=float(np.clip(BLINK_LAG_S * random.standard_normal(), -LONGEST_BLINK_LAG_S, LONGEST_BLINK_LAG_S)),
        phonemes=annotation.phonemes,
        mouth=_mouth_habit(annotation, style),
        face=_face(annotation, style, seconds, random),
        face_tide=_mood_tide(random),
    )


def _mood_tide(random: np.random.Generator) -> Waves:
    """How an emotion comes and goes, about 0."""
    amplitude = np.full((3, 1), MOOD_TIDE * np.sqrt(2.0 / 3.0))
    return Waves(random.uniform(*MOOD_HZ, 3), amplitude, random.uniform(0, 2 * np.pi, (3, 1)))


def _lid_unrest(random: np.random.Generator) -> Waves:
    """Slow lid motion on still eyes: a spectrum flat up to the memory's corner and falling beyond, both eyes alike."""
    low, high = np.log(LID_UNREST_HZ)
    frequency = np.exp(random.uniform(low, high, LID_WAVES))
    power = frequency / (1.0 + (2.0 * np.pi * 0.5 * frequency) ** 2)
    amplitude = LID_UNREST_RAD * np.sqrt(2.0 * power / power.sum())
    phase = random.uniform(0, 2 * np.pi, (LID_WAVES, 1)) + random.normal(0.0, LID_DIFFERENCE_RAD, (LID_WAVES, 2))
    return Waves(frequency, np.repeat(amplitude[:, None], 2, axis=1), phase)


def _share(annotation: Annotation, style: Style) -> float:
    """How much of the emotion shows in this face."""
    return float(min(face.SHARE_OF_INTENSITY[annotation.intensity] * style.expressiveness, 1.2))


def _mouth_habit(annotation: Annotation, style: Style) -> MouthHabit:
    feeling, share = face.FEELINGS[annotation.emotion], _share(annotation, style)
    return MouthHabit(
        jaw_scale=style.jaw_scale * (1.0 + share * (feeling.jaw_scale - 1.0)),
        lip_scale=style.lip_scale,
        jaw_asymmetry=style.jaw_asymmetry,
        jaw_rest_rad=share * feeling.jaw_rest_rad,
    )


def _face(annotation: Annotation, style: Style, seconds: float, random: np.random.Generator) -> face.Face:
    brows = draw_brow_raises(annotation, style.coupling, seconds, random)
    return face.Face(annotation.emotion, _share(annotation, style), brows)


def _blinks(
    annotation: Annotation,
    style: Style,
    seconds: float,
    shifts: Sequence[Saccade],
    partner_rad: Float[ndarray, " 2"],
    random: np.random.Generator,
    profile: BlinkProfile,
) -> tuple[Blink, ...]:
    """Blinks with large gaze shifts (Evinger 1994), and spontaneous ones that make up the speaker's rate."""
    evoked = []
    for shift in shifts:
        start, end = (np.hypot(*(np.array(place) - partner_rad)) for place in (shift.start_rad, shift.end_rad))
        chance = blinks.evoked_probability(float(np.hypot(*np.subtract(shift.end_rad, shift.start_rad))))
        if shift.onset_s >= 0 and random.random() < chance * (TOWARDS_PARTNER if end < start else 1.0):
            evoked.append(blinks.draw_blink(profile, shift.onset_s + random.uniform(-0.03, 0.03), random, EVOKED_FULL))
    spontaneous = max(style.blinks_per_min - 60.0 * len(evoked) / seconds, LEAST_SPONTANEOUS * style.blinks_per_min)
    others = blinks.draw_blinks(profile, seconds, random, annotation, spontaneous, style.blink_completeness)
    return blinks.without_overlap(evoked, others)
