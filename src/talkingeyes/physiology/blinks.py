"""Blinks: rates, timing and lid kinematics.

Rates: `PAPER` is the paper's N(40.10, 15.42) per minute with a 5-frame window (Sect. IV-E). `PHYSIOLOGICAL` is
log-normal over people with median 23 (Bentivoglio 1997; Doughty 2001), with VanderWerf's (2003) kinematics, and, if the
speech is known, more blinks at phrase ends and in pauses (Nakano & Kitazawa 2010). A profile fitted to a corpus has the
same form. During lid closure the eyes rotate downwards and nasally (Collewijn et al. 1985). Times are in seconds.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import betainc, ndtr, ndtri

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Blink

# Values without a source are choices of this project.
RATE_LIMITS_PER_MIN = (6.0, 50.0)
INTERVAL_SHAPE = 1.5
# Hazard around the end of a phrase, in pauses and in phrases of the speaker; after a phrase of the partner, else while
# listening.
PHRASE_END_S, PARTNER_END_S = (-0.1, 0.5), (0.25, 0.5)
PHRASE_END_FACTOR, PAUSE_FACTOR, PHRASE_FACTOR = 3.0, 2.0, 0.7
PARTNER_END_FACTOR, LISTENING_FACTOR = 3.0, 0.9
REFRACTORY_S = 0.25
MEAN_BLINK_S = 0.33
COMPLETE_PROBABILITY = 0.7
OPENING_DECAY = 3.0
# Eye rotation of a full blink: down, and nasal (1 to 5 degrees in all).
DOWN_RAD, NASAL_RAD = np.radians(1.6), np.radians(0.6)


@dataclass(frozen=True)
class BlinkProfile:
    """Distribution of blinks per minute over people or clips, and kinematics of a blink.

    `normal`: mean and standard deviation, truncated at 0. `lognormal`: median and standard deviation of the logarithm,
    clipped to RATE_LIMITS_PER_MIN. `window_s` is the fixed duration of a blink, or None for physiological kinematics.
    """

    distribution: Literal["normal", "lognormal"]
    centre_per_min: float
    spread: float
    window_s: float | None = None
    # whether the hazard rises at phrase ends and in pauses, if these are known
    speech_dependent: bool = True


PAPER = BlinkProfile("normal", 40.10, 15.42, window_s=0.200, speech_dependent=False)
PHYSIOLOGICAL = BlinkProfile("lognormal", 23.0, 0.35)
PROFILES = {"paper": PAPER, "physiological": PHYSIOLOGICAL}


def sample_blink_rate(profile: BlinkProfile, rng: np.random.Generator) -> float:
    """Sample the blinks per minute of one person (or clip)."""
    if profile.distribution == "lognormal":
        return float(
            np.clip(profile.centre_per_min * np.exp(profile.spread * rng.standard_normal()), *RATE_LIMITS_PER_MIN)
        )
    rate = -1.0
    while rate <= 0:
        rate = rng.normal(profile.centre_per_min, profile.spread)
    return float(rate)


def blink_rate_quantile(profile: BlinkProfile, share: float) -> float:
    """Quantile of blinks per minute of a profile, for a probability strictly between 0 and 1."""
    if profile.distribution == "lognormal":
        return float(np.clip(profile.centre_per_min * np.exp(profile.spread * ndtri(share)), *RATE_LIMITS_PER_MIN))
    below = ndtr(-profile.centre_per_min / profile.spread)  # probability truncated at 0
    return float(profile.centre_per_min + profile.spread * ndtri(below + (1.0 - below) * share))


def sample_blinks(
    profile: BlinkProfile,
    seconds: float,
    rng: np.random.Generator,
    annotation: Annotation | None = None,
    rate_per_min: float | None = None,
    full: float = COMPLETE_PROBABILITY,
) -> Iterator[Blink]:
    """Sample blinks over `seconds`, at a rate from the profile unless given; `full` is the probability of full closure.

    A renewal process with gamma intervals after a refractory time, in time warped by the hazard from speech if the
    profile is speech-dependent. Each blink is sampled when it is asked for, so that a stream need not wait for those of
    an hour.
    """
    rate = sample_blink_rate(profile, rng) if rate_per_min is None else rate_per_min
    mean_s = 60.0 / max(rate, 1e-6)
    length_s = profile.window_s or MEAN_BLINK_S + REFRACTORY_S
    dead_s = min(length_s, 0.6 * mean_s)
    warm_up_s = 4.0 * mean_s
    count = int(2.0 * (seconds + warm_up_s) / mean_s) + 20
    steps_s = dead_s + rng.gamma(INTERVAL_SHAPE, (mean_s - dead_s) / INTERVAL_SHAPE, count)
    even_s = np.cumsum(steps_s) - warm_up_s
    even_s = even_s[(even_s >= 0) & (even_s < seconds)]
    onsets_s = _warp_times(even_s, seconds, annotation if profile.speech_dependent else None)
    end = -np.inf
    for onset in onsets_s:
        blink = sample_blink(profile, onset, rng, full)
        if end <= blink.onset_s:
            end = end_s(blink)
            yield blink


def sample_blink(
    profile: BlinkProfile, onset_s: float, rng: np.random.Generator, full: float = COMPLETE_PROBABILITY
) -> Blink:
    """Sample one blink; `full` is the probability of full closure."""
    if profile.window_s is not None:
        return Blink(float(onset_s), 0.4 * profile.window_s, 0.2 * profile.window_s, 0.4 * profile.window_s, 1.0)
    return Blink(
        onset_s=float(onset_s),
        closing_s=float(max(0.045, rng.normal(0.085, 0.015))),
        hold_s=float(0.025 * np.exp(0.6 * rng.standard_normal())),
        opening_s=float(max(0.100, rng.normal(0.210, 0.045))),
        depth=1.0 if rng.random() < full else float(rng.uniform(0.4, 0.9)),
    )


def drop_overlapping(first: Sequence[Blink], others: Sequence[Blink] = ()) -> tuple[Blink, ...]:
    """Blinks in order of onset: from `first`, then from `others`, those that do not overlap one already kept."""
    kept: list[Blink] = []
    for group in (first, others):
        for blink in sorted(group, key=_onset_s):
            place = bisect(kept, blink.onset_s, key=_onset_s)
            free = not place or end_s(kept[place - 1]) <= blink.onset_s
            if free and (place == len(kept) or end_s(blink) <= kept[place].onset_s):
                kept.insert(place, blink)
    return tuple(kept)


def _onset_s(blink: Blink) -> float:
    return blink.onset_s


def end_s(blink: Blink) -> float:
    """End of a blink."""
    return blink.onset_s + blink.closing_s + blink.hold_s + blink.opening_s


def blink_closure(blinks: Sequence[Blink], times_s: Float[ndarray, " T"]) -> Float[ndarray, " T"]:
    """Closure by blinks at ascending times: 0 open, 1 shut."""
    total = np.zeros(len(times_s))
    for blink in blinks:
        first, last = np.searchsorted(times_s, [blink.onset_s, end_s(blink)])
        after = times_s[first:last] - blink.onset_s
        down = betainc(2.2, 2.5, np.clip(after / blink.closing_s, 0.0, 1.0))
        opening = np.clip((after - blink.closing_s - blink.hold_s) / blink.opening_s, 0.0, 1.0)
        left = (np.exp(-OPENING_DECAY * opening) - np.exp(-OPENING_DECAY)) / (1.0 - np.exp(-OPENING_DECAY))
        total[first:last] = np.maximum(total[first:last], blink.depth * np.minimum(down, left))
    return total


def blink_eye_rotation_rad(closed: Float[ndarray, "T 2"]) -> Float[ndarray, "T 2 2"]:
    """Eye rotations (yaw, pitch) caused by blinks with these closures of the left and the right eye."""
    nasal = np.stack([-closed[:, 0], closed[:, 1]], axis=-1)
    return np.stack([NASAL_RAD * nasal, -DOWN_RAD * closed], axis=-1)


def evoked_blink_probability(amplitude_rad: float) -> float:
    """Probability that a gaze shift of this amplitude evokes a blink (Evinger et al. 1994)."""
    return float(0.97 * np.clip((np.degrees(amplitude_rad) - 5.0) / 28.0, 0.0, 1.0))


def _warp_times(even_s: Float[ndarray, " N"], seconds: float, annotation: Annotation | None) -> Float[ndarray, " N"]:
    """Warp uniform times by the cumulative hazard; the number of blinks does not change."""
    if annotation is None or len(even_s) == 0:
        return even_s
    grid_s = np.arange(0.0, seconds + 0.02, 0.02)
    factor = np.full(len(grid_s), PAUSE_FACTOR)
    for spans, value in ((annotation.listening, LISTENING_FACTOR), (annotation.speaking, PHRASE_FACTOR)):
        for span in spans:
            factor[(grid_s >= span.start_s) & (grid_s < span.end_s)] = value
    for spans, window_s, value in (
        (annotation.partner, PARTNER_END_S, PARTNER_END_FACTOR),
        (annotation.speaking, PHRASE_END_S, PHRASE_END_FACTOR),
    ):
        for span in spans:
            factor[(grid_s >= span.end_s + window_s[0]) & (grid_s < span.end_s + window_s[1])] = value
    summed = np.concatenate([[0.0], np.cumsum(factor[:-1])])
    return np.asarray(np.interp(even_s / seconds * summed[-1], summed, grid_s))
