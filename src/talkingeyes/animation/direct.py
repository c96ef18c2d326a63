"""A model's course is directed: whose manner, how lively, listening to whom, at whom gaze is, what it goes to.

Each step changes the course only where it is asked to, in an order in which the later ones have the last word: targets
over eye contact, eye contact over liveliness and manner. Blinks that come with large shifts of gaze (`blinks_with`)
are drawn first; in the others (`blinks_of`), which give way to them, gaze holds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.aiming import aimed
from talkingeyes.animation.contact import contacted
from talkingeyes.animation.course import Course, scaled, within_reach
from talkingeyes.animation.direction import Direction, Liveliness
from talkingeyes.animation.listening import Listening
from talkingeyes.animation.manner import in_manner
from talkingeyes.animation.oculomotor import capped, interrupted
from talkingeyes.animation.targets import LISTENER, TargetTrack
from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Blink
from talkingeyes.fitting.manner import Manner
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile

MOST_BROUGHT = 0.75  # of all blinks, by shifts of gaze
WITH_SHIFT_S = 0.03  # a blink that comes with a shift starts at most so much earlier or later


@dataclass(frozen=True)
class Asked:
    """A direction whose style has been found and whose partner has been listened to; one's own phrases.

    `blinks_less` is the share of people who blink less often than this person, if that is known.
    """

    direction: Direction
    manner: Manner | None = None
    blinks_less: float | None = None
    listening: Listening | None = None
    spoken: Annotation | None = None


def blinks_per_min(profile: BlinkProfile, asked: Asked, random: np.random.Generator) -> float:
    """The rate of the manner, or of the person in the profile, or of anybody in it; times the dial."""
    if asked.manner:
        rate = asked.manner.blinks_per_min
    elif asked.blinks_less is not None:
        rate = blinks.rate_at_per_min(profile, asked.blinks_less)
    else:
        rate = blinks.draw_rate_per_min(profile, random)
    return rate * asked.direction.liveliness.blinks


def blinks_with(profile: BlinkProfile, course: Course, rate: float, random: np.random.Generator) -> tuple[Blink, ...]:
    """Blinks that large shifts of gaze bring (Evinger 1994), of so many a minute in all."""
    brought = compress(course.saccades, random.random(len(course.saccades)) < _chances(profile, course, rate))
    times_s = [shift.onset_s + random.uniform(-WITH_SHIFT_S, WITH_SHIFT_S) for shift in brought]
    return blinks.without_overlap([blinks.draw_blink(profile, max(time_s, 0.0), random) for time_s in times_s])


def blinks_of(
    profile: BlinkProfile,
    asked: Asked,
    seconds: float,
    rate: float,
    brought: Sequence[Blink],
    random: np.random.Generator,
) -> tuple[Blink, ...]:
    """Blinks where talk has them; with those that the shifts of gaze bring (`blinks_with`), so many a minute."""
    # Where they would run into one that was brought, they are left out: so many more are drawn.
    taken_s = sum(blinks.end_s(each) - each.onset_s + blinks.USUAL_BLINK_S for each in brought)
    left = rate * seconds / 60.0 - len(brought)
    if left <= 0 or taken_s >= seconds:
        return ()
    annotation = asked.listening.annotation if asked.listening else asked.spoken
    drawn = blinks.draw_blinks(profile, seconds, random, annotation, 60.0 * left / (seconds - taken_s))
    return tuple(each for each in blinks.without_overlap(brought, drawn) if each not in brought)


def _chances(profile: BlinkProfile, course: Course, rate: float) -> Float[ndarray, " N"]:
    """How likely each shift brings a blink; the paper's blinks heed nothing.

    Some blinks are left to come without. Where there are not enough for all shifts, the largest keep theirs.
    """
    chances = np.array([blinks.evoked_probability(math.dist(each.start_rad, each.end_rad)) for each in course.saccades])
    most = 0.0 if profile.window_s is not None else MOST_BROUGHT * rate * course.seconds / 60.0
    largest_first = np.argsort(-chances, kind="stable")
    before = np.cumsum(chances[largest_first]) - chances[largest_first]
    chances[largest_first] = np.clip(most - before, 0.0, chances[largest_first])
    return chances


def directed(course: Course, asked: Asked, seeds: Sequence[int]) -> Course:
    """The course as it is asked for; `seeds` are those of this sample."""
    own, direction = course, asked.direction
    if asked.manner:
        course = in_manner(course, asked.manner, [*seeds, 1])
    course = lively(course, direction.liveliness)
    listener = (direction.targets or TargetTrack()).place(LISTENER).at(course.times_s)
    if asked.listening:
        nods = eye_head.head_path(asked.listening.nods, course.times_s)
        course = replace(course, head=course.head + direction.liveliness.head * nods)
    if direction.contact is not None:
        course = contacted(course, listener, direction.contact, [*seeds, 2])
    elif asked.listening:
        listens = asked.listening.annotation.listening
        course = contacted(course, listener, asked.listening.look, [*seeds, 2], listens)
        course = contacted(course, listener, 0.0, [*seeds, 5], asked.listening.averted)
    if not direction.as_drawn:
        course = interrupted(capped(course), direction.liveliness.gaze, [*seeds, 4])
    if direction.targets:
        course = aimed(course, direction.targets)
    return within_reach(course, own)


def lively(course: Course, dials: Liveliness) -> Course:
    """Head and gaze as far from where they usually are as the dials say."""
    if dials.gaze != 1.0:
        centre = np.median(course.together_rad, axis=0)
        course = scaled(course, centre, np.full(2, dials.gaze), centre)
    if dials.head != 1.0:
        mean = course.head.mean(axis=0)
        course = replace(course, head=mean + dials.head * (course.head - mean))
    return course
