"""One take: everything a speaker does while saying one sound, from that speaker's style and the take's own randomness.

The sound enters only through its annotation, and only through coin tosses: takes of one sound differ in all but jaw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes import rotation
from talkingeyes.audio.annotation import Annotation
from talkingeyes.motion import Blink, Events, Motion, Refocus, Saccade
from talkingeyes.physiology import blinks, render
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.physiology.render import Continuous, Waves
from talkingeyes.world import gestures
from talkingeyes.world.conversation import WARM_UP_S, Look, looks
from talkingeyes.world.looking import look_around
from talkingeyes.world.speakers import Style

LID_UNREST = 0.03  # closure; about 1.2 degrees of lid
# How much rarer blinks are in shifts back to the partner: suppressed towards what matters (Williamson 2005). FACTS' .4
# would leave shifts of 20 to 30 degrees, most of them ways back, far below Evinger's share of blinks.
TOWARDS_PARTNER = 0.75
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
    """Draw a take of a sound that is `seconds` long."""
    continuous = _continuous(annotation, style, random)
    gestured = gestures.posture_shifts(annotation, style, random) + gestures.nods(annotation, style, random)
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


def _continuous(annotation: Annotation, style: Style, random: np.random.Generator) -> Continuous:
    posture = np.array([style.rest_pitch, 0.0, style.rest_roll]) + np.radians(0.7) * random.standard_normal(3)
    drift, *speaking = (gestures.unrest(band, style.head_scale, random) for band in gestures.BANDS.values())
    unrest = Waves(
        random.uniform(0.1, 0.8, 4), np.full((4, 2), LID_UNREST / np.sqrt(2.0)), random.uniform(0, 2 * np.pi, (4, 2))
    )
    return Continuous(
        gaze_rest_rad=(0.0, 0.0),
        kappa_rad=np.array(style.kappa),
        head_rest=posture,
        head_waves=drift,
        head_speaking=gestures.joined(*speaking),
        activity=gestures.activity(annotation),
        translation=gestures.translation(random),
        lid_rest=style.lid_rest,
        lid_waves=unrest,
        blink_lag_s=float(np.clip(BLINK_LAG_S * random.standard_normal(), -LONGEST_BLINK_LAG_S, LONGEST_BLINK_LAG_S)),
        phonemes=annotation.phonemes,
        jaw_scale=style.jaw_scale,
        jaw_asymmetry=style.jaw_asymmetry,
    )


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
