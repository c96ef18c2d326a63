"""Blinks of an animation: those that accompany large gaze shifts, and spontaneous ones at the rest of the rate.

The rate follows the paper (Sect. IV-E): one per animation, sampled from a profile, or the speaker's quantile in it.
An emotion changes it by the rule of the synthetic data. Spontaneous blinks leave room for the gaze-evoked ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.core.motion import Blink
from talkingeyes.models.condition.emotion_strength import STRENGTH_EMOTIONS, emotion_strengths
from talkingeyes.models.face.style import StyleKey, blend_over_time
from talkingeyes.physiology import blinks
from talkingeyes.physiology.blinks import BlinkProfile
from talkingeyes.synthesis.emotion import EMOTION_FACTORS

MAX_EVOKED_FRACTION = 0.75  # of all blinks
EVOKED_JITTER_S = 0.03  # a gaze-evoked blink starts at most this much before or after its saccade
SHUT_CLOSURE = 0.5


@dataclass(frozen=True)
class SampledBlinks:
    """Gaze-evoked and spontaneous blinks; they do not overlap."""

    evoked: tuple[Blink, ...] = ()
    spontaneous: tuple[Blink, ...] = ()

    @property
    def all(self) -> tuple[Blink, ...]:
        """All blinks in order of time."""
        return blinks.drop_overlapping(self.evoked, self.spontaneous)


def sample_blinks(trajectory: GazeTrajectory, context: AnimationContext) -> SampledBlinks:
    """Sample the blinks of a trajectory; none where the controls replace them or switch them off."""
    if not context.controls.parts.is_generated("blinks"):
        return SampledBlinks()
    rng = np.random.default_rng(context.seeds)
    rate = blinks_per_min(context, rng) * emotional_blinks(context.controls.face, trajectory.times_s)
    evoked = gaze_evoked_blinks(trajectory, rate, context, rng)
    return SampledBlinks(evoked, spontaneous_blinks(trajectory.seconds, rate, evoked, context, rng))


def blinks_per_min(context: AnimationContext, rng: np.random.Generator) -> float:
    """The rate of the style, else the speaker's quantile of the profile, else a sample of it; times liveliness."""
    if context.motion_style:
        rate = context.motion_style.blinks_per_min
    elif context.blink_rate_rank is not None:
        rate = blinks.blink_rate_quantile(context.blink_profile, context.blink_rate_rank)
    else:
        rate = blinks.sample_blink_rate(context.blink_profile, rng)
    return rate * context.controls.liveliness.blinks


def emotional_blinks(style: Sequence[StyleKey], times_s: Float[ndarray, " T"]) -> float:
    """Factor of the emotion on the blink rate (synthesis/emotion.py), the geometric mean over time."""
    logs = np.log([EMOTION_FACTORS[name].blinks for name in STRENGTH_EMOTIONS])
    return float(np.exp((blend_over_time(style, times_s, emotion_strengths) @ logs).mean()))


def gaze_evoked_blinks(
    trajectory: GazeTrajectory, rate_per_min: float, context: AnimationContext, rng: np.random.Generator
) -> tuple[Blink, ...]:
    """Sample the blinks that accompany large gaze shifts (Evinger et al. 1994), given the rate of all blinks."""
    profile, count = context.blink_profile, len(trajectory.saccades)
    evoking = compress(
        trajectory.saccades, rng.random(count) < _evoked_probabilities(profile, trajectory, rate_per_min)
    )
    times_s = [saccade.onset_s + rng.uniform(-EVOKED_JITTER_S, EVOKED_JITTER_S) for saccade in evoking]
    return blinks.drop_overlapping([blinks.sample_blink(profile, max(time_s, 0.0), rng) for time_s in times_s])


def spontaneous_blinks(
    seconds: float, rate_per_min: float, evoked: Sequence[Blink], context: AnimationContext, rng: np.random.Generator
) -> tuple[Blink, ...]:
    """Sample the other blinks at the phase of speech where people blink, so that all blinks have the rate.

    Those that would overlap a gaze-evoked blink are dropped, and the rate is raised to make up for it.
    """
    occupied_s = sum(blinks.end_s(blink) - blink.onset_s + blinks.MEAN_BLINK_S for blink in evoked)
    missing = rate_per_min * seconds / 60.0 - len(evoked)
    if missing <= 0 or occupied_s >= seconds:
        return ()
    free_rate = 60.0 * missing / (seconds - occupied_s)
    candidates = tuple(blinks.sample_blinks(context.blink_profile, seconds, rng, context.turns, free_rate))
    return tuple(blink for blink in blinks.drop_overlapping(evoked, candidates) if blink not in evoked)


def shut_frames(sampled_blinks: Sequence[Blink], times_s: Float[ndarray, " T"]) -> Bool[ndarray, " T"]:
    """Whether the lids are shut at each time, where the eyes do not move (the paper's post-processing, Sect. IV-E)."""
    return np.asarray(blinks.blink_closure(sampled_blinks, times_s) >= SHUT_CLOSURE)


def _evoked_probabilities(
    profile: BlinkProfile, trajectory: GazeTrajectory, rate_per_min: float
) -> Float[ndarray, " N"]:
    """The probability of a blink with each saccade; 0 for the paper's blinks, which are independent of gaze.

    Their sum is at most `MAX_EVOKED_FRACTION` of all blinks; where it would be more, the largest saccades keep theirs.
    """
    chances = np.array(
        [blinks.evoked_blink_probability(math.dist(each.start_rad, each.end_rad)) for each in trajectory.saccades]
    )
    most = 0.0 if profile.window_s is not None else MAX_EVOKED_FRACTION * rate_per_min * trajectory.seconds / 60.0
    largest_first = np.argsort(-chances, kind="stable")
    before = np.cumsum(chances[largest_first]) - chances[largest_first]
    chances[largest_first] = np.clip(most - before, 0.0, chances[largest_first])
    return chances
