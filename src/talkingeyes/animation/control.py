"""A model's course is directed: whose manner, how lively, listening to whom, at whom gaze is, what it goes to.

Each step changes the course only where it is asked to, in an order in which the later ones have the last word: targets
over eye contact, eye contact over liveliness and manner. Blinks that come with large shifts of gaze
(`gaze_evoked_blinks`) are drawn first; in the others (`spontaneous_blinks`), which give way to them, gaze holds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.eye_contact import apply_eye_contact
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, clamp_gaze, scale_gaze
from talkingeyes.animation.listening import ListeningBehaviour
from talkingeyes.animation.oculomotor import add_saccadic_intrusions, limit_amplitude
from talkingeyes.animation.style_transfer import apply_style
from talkingeyes.animation.target_following import apply_targets
from talkingeyes.animation.targets import LISTENER, TargetTrack
from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Blink
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.physiology import blinks, eye_head
from talkingeyes.physiology.blinks import BlinkProfile

MAX_EVOKED_FRACTION = 0.75  # of all blinks, by shifts of gaze
EVOKED_JITTER_S = 0.03  # a blink that comes with a shift starts at most so much earlier or later


@dataclass(frozen=True)
class ResolvedControls:
    """A direction whose style has been found and whose partner has been listened to; one's own phrases.

    `blink_rate_rank` is the share of people who blink less often than this person, if that is known.
    """

    controls: Controls
    motion_style: MotionStyle | None = None
    blink_rate_rank: float | None = None
    listening: ListeningBehaviour | None = None
    own_speech: Annotation | None = None


def blinks_per_min(profile: BlinkProfile, requested: ResolvedControls, rng: np.random.Generator) -> float:
    """The rate of the manner, or of the person in the profile, or of anybody in it; times the dial."""
    if requested.motion_style:
        rate = requested.motion_style.blinks_per_min
    elif requested.blink_rate_rank is not None:
        rate = blinks.blink_rate_quantile(profile, requested.blink_rate_rank)
    else:
        rate = blinks.sample_blink_rate(profile, rng)
    return rate * requested.controls.liveliness.blinks


def gaze_evoked_blinks(
    profile: BlinkProfile, trajectory: GazeTrajectory, rate: float, rng: np.random.Generator
) -> tuple[Blink, ...]:
    """Blinks that large shifts of gaze bring (Evinger 1994), of so many a minute in all."""
    evoked = compress(
        trajectory.saccades, rng.random(len(trajectory.saccades)) < _evoked_probabilities(profile, trajectory, rate)
    )
    times_s = [shift.onset_s + rng.uniform(-EVOKED_JITTER_S, EVOKED_JITTER_S) for shift in evoked]
    return blinks.drop_overlapping([blinks.sample_blink(profile, max(time_s, 0.0), rng) for time_s in times_s])


def spontaneous_blinks(
    profile: BlinkProfile,
    requested: ResolvedControls,
    seconds: float,
    rate: float,
    evoked: Sequence[Blink],
    rng: np.random.Generator,
) -> tuple[Blink, ...]:
    """Blinks where talk has them; with those that the shifts of gaze bring (`gaze_evoked_blinks`), so many a minute."""
    # Where they would run into one that was brought, they are left out: so many more are drawn.
    taken_s = sum(blinks.end_s(each) - each.onset_s + blinks.MEAN_BLINK_S for each in evoked)
    left = rate * seconds / 60.0 - len(evoked)
    if left <= 0 or taken_s >= seconds:
        return ()
    annotation = requested.listening.annotation if requested.listening else requested.own_speech
    drawn = blinks.sample_blinks(profile, seconds, rng, annotation, 60.0 * left / (seconds - taken_s))
    return tuple(each for each in blinks.drop_overlapping(evoked, drawn) if each not in evoked)


def _evoked_probabilities(profile: BlinkProfile, trajectory: GazeTrajectory, rate: float) -> Float[ndarray, " N"]:
    """How likely each shift brings a blink; the paper's blinks heed nothing.

    Some blinks are left to come without. Where there are not enough for all shifts, the largest keep theirs.
    """
    chances = np.array(
        [blinks.evoked_blink_probability(math.dist(each.start_rad, each.end_rad)) for each in trajectory.saccades]
    )
    most = 0.0 if profile.window_s is not None else MAX_EVOKED_FRACTION * rate * trajectory.seconds / 60.0
    largest_first = np.argsort(-chances, kind="stable")
    before = np.cumsum(chances[largest_first]) - chances[largest_first]
    chances[largest_first] = np.clip(most - before, 0.0, chances[largest_first])
    return chances


def apply_controls(trajectory: GazeTrajectory, requested: ResolvedControls, seeds: Sequence[int]) -> GazeTrajectory:
    """The course as it is asked for; `seeds` are those of this sample."""
    own, controls = trajectory, requested.controls
    if requested.motion_style:
        trajectory = apply_style(trajectory, requested.motion_style, [*seeds, 1])
    trajectory = apply_liveliness(trajectory, controls.liveliness)
    listener = (controls.targets or TargetTrack()).object_track(LISTENER).at(trajectory.times_s)
    if requested.listening:
        nods = eye_head.head_path(requested.listening.nods, trajectory.times_s)
        trajectory = replace(trajectory, head=trajectory.head + controls.liveliness.head * nods)
    if controls.eye_contact is not None:
        trajectory = apply_eye_contact(trajectory, listener, controls.eye_contact, [*seeds, 2])
    elif requested.listening:
        listens = requested.listening.annotation.listening
        trajectory = apply_eye_contact(trajectory, listener, requested.listening.gaze_fraction, [*seeds, 2], listens)
        trajectory = apply_eye_contact(trajectory, listener, 0.0, [*seeds, 5], requested.listening.aversions)
    if not controls.no_postprocessing:
        trajectory = add_saccadic_intrusions(limit_amplitude(trajectory), controls.liveliness.gaze, [*seeds, 4])
    if controls.targets:
        trajectory = apply_targets(trajectory, controls.targets)
    return clamp_gaze(trajectory, own)


def apply_liveliness(trajectory: GazeTrajectory, dials: Liveliness) -> GazeTrajectory:
    """Head and gaze as far from where they usually are as the dials say."""
    if dials.gaze != 1.0:
        centre = np.median(trajectory.cyclopean_rad, axis=0)
        trajectory = scale_gaze(trajectory, centre, np.full(2, dials.gaze), centre)
    if dials.head != 1.0:
        mean = trajectory.head.mean(axis=0)
        trajectory = replace(trajectory, head=mean + dials.head * (trajectory.head - mean))
    return trajectory
