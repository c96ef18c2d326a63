"""Timing of gaze at the partner and gaze aversion while talking and listening, sampled anew for each take.

People avert gaze to plan what they say, to hold the floor, and to regulate intimacy (Andrist, Mutlu & Gleicher 2013).
Speakers avert gaze more than listeners do (Argyle & Cook 1976), start to speak with averted gaze and end with gaze at
the partner (Kendon 1967; Ho, Foulsham & Kingstone 2015), and look away when they hesitate: Kendon (1967) reports gaze
at the partner in 50 % of fluent and 20 % of hesitant speech. Fillers alone do not reliably come with averted gaze
(Jehoul et al.), so only silent hesitations are cues. How strong and when each of these is, and how long people look, is
estimated from recorded pairs (physiology/contact_population.py); the recordings do not have hesitations. Each coupling
is a random event with its own latency, so speech predicts gaze only weakly, as in humans. Times are in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import expit, logit

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.physiology.contact_population import ContactState, StateContact
from talkingeyes.synthesis.speakers import SpeakerStyle

AversionCause = Literal["planning", "floor", "intimacy"]

# Our choices: gaze is at the partner less in silent hesitations than otherwise; Kendon's figures are of few dyads. The
# timing (mean, standard deviation) is relative to start and end of the pause.
HESITATION_PROBABILITY = 0.9
HESITATION_START_S, HESITATION_END_S = (-0.30, 0.30), (0.60, 0.40)
MIN_PAUSE_S = 0.25  # shorter gaps do not end an utterance
PLANNED_PAUSE_S = 0.5  # after longer pauses, the next utterance is planned
SHARE_EXPONENT = 0.5  # who looks at the partner more has longer looks and shorter aversions, each by the root
MIN_DWELL_S = 0.2
WARM_UP_S = 6.0


@dataclass(frozen=True)
class GazeInterval:
    """An interval with one gaze state; `cause` is the cause of an aversion (meaningless otherwise)."""

    start_s: float
    end_s: float
    averted: bool
    cause: AversionCause = "intimacy"


@dataclass(frozen=True)
class GazeCues:
    """Gaze cues of the speech: intervals of aversion and times of return to the partner, ascending."""

    aversions: tuple[GazeInterval, ...]
    returns_s: tuple[float, ...]


def sample_gaze_cues(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> GazeCues:
    """Sample cues at starts and ends of utterances; fewer for weak speech coupling or low liveliness."""
    aversions, back = [], []
    law = style.contact.cues
    lively = style.speech_coupling * min(1.0, style.liveliness)
    spans = annotation.speaking
    for index, span in enumerate(spans):
        before_s = span.start_s - spans[index - 1].end_s if index else np.inf
        after_s = spans[index + 1].start_s - span.end_s if index + 1 < len(spans) else np.inf
        cause: AversionCause = "planning" if before_s >= PLANNED_PAUSE_S else "floor"
        chance = law.planning if cause == "planning" else law.floor
        chance *= 1.0 - np.exp(-_turn_left_s(annotation, index) / law.planned_s)
        if before_s >= MIN_PAUSE_S and rng.random() < chance * lively * _aversion_tendency(style):
            start, end = (span.start_s + rng.normal(*each) for each in (law.aversion_start_s, law.aversion_end_s))
            aversions.append(GazeInterval(start, max(end, start + MIN_DWELL_S), True, cause))
        chance = law.turn_end if after_s >= PLANNED_PAUSE_S else law.pause
        if after_s >= MIN_PAUSE_S and rng.random() < chance * (0.3 + 0.7 * style.speech_coupling):
            back.append(span.end_s + rng.uniform(*law.return_s))
    for pause in annotation.pauses:
        if pause.label == "hesitation" and rng.random() < HESITATION_PROBABILITY * lively * _aversion_tendency(style):
            start = pause.start_s + rng.normal(*HESITATION_START_S)
            end = pause.end_s + rng.normal(*HESITATION_END_S)
            aversions.append(GazeInterval(start, max(end, start + MIN_DWELL_S), True, "planning"))
    delay_s = style.cue_delay_s
    delayed = (replace(each, start_s=each.start_s + delay_s, end_s=each.end_s + delay_s) for each in aversions)
    return GazeCues(
        tuple(sorted(delayed, key=lambda interval: interval.start_s)), tuple(sorted(each + delay_s for each in back))
    )


def gaze_intervals(
    annotation: Annotation, style: SpeakerStyle, seconds: float, rng: np.random.Generator
) -> list[GazeInterval]:
    """Alternating gaze states from WARM_UP_S before the clip, so that it starts in mid-conversation, to its end."""
    cues = sample_gaze_cues(annotation, style, rng)
    time = -WARM_UP_S
    averted, cause = bool(rng.random() > _law(_state(annotation, time), style)[1]), _cause_at(cues, time)
    states: list[GazeInterval] = []
    while time < seconds:
        end = (_end_away if averted else _end_looking)(time, cues, _state(annotation, time), style, rng)
        states.append(GazeInterval(time, end, averted, cause))
        time, averted = end, not averted
        cause = _cause_at(cues, time)
    return states


def _state(annotation: Annotation, time_s: float) -> ContactState:
    """The partner has the turn or not; without turns of a partner, an interview."""
    if not annotation.listening:
        return "interview"
    return "listening" if listens(annotation.listening, time_s) else "speaking"


def listens(listening: tuple[Span, ...], time_s: float) -> bool:
    """Whether the partner has the turn."""
    return any(span.start_s <= time_s < span.end_s for span in listening)


def _turn_left_s(annotation: Annotation, index: int) -> float:
    """From the start of an utterance to the end of the last one before the partner's next turn."""
    start_s = annotation.speaking[index].start_s
    until_s = min((span.start_s for span in annotation.listening if span.start_s > start_s), default=np.inf)
    return max(span.end_s for span in annotation.speaking[index:] if span.start_s < until_s) - start_s


def _cause_at(cues: GazeCues, time_s: float) -> AversionCause:
    """Cause of an aversion that starts at a time: that of the cue, or intimacy without a cue."""
    for interval in cues.aversions:
        if interval.start_s <= time_s < interval.end_s:
            return interval.cause
    return "intimacy"


def _end_looking(
    time_s: float, cues: GazeCues, state: ContactState, style: SpeakerStyle, rng: np.random.Generator
) -> float:
    """End of an interval of gaze at the partner: the next aversion cue, or a duration sampled for the style."""
    earliest = time_s + MIN_DWELL_S
    spontaneous_end_s = time_s + sample_dwell_s(False, state, style, rng)
    wanted = [max(interval.start_s, earliest) for interval in cues.aversions if time_s < interval.start_s]
    return float(min([max(spontaneous_end_s, earliest), *wanted]))


def _end_away(
    time_s: float, cues: GazeCues, state: ContactState, style: SpeakerStyle, rng: np.random.Generator
) -> float:
    """End of an aversion: that of its cue or a sampled duration, or an earlier return cue."""
    earliest = time_s + MIN_DWELL_S
    length_s = sample_dwell_s(True, state, style, rng)
    end = max(earliest, time_s + length_s)
    for interval in cues.aversions:
        if interval.start_s <= time_s < interval.end_s:
            end = max(earliest, interval.end_s)
        elif time_s < interval.start_s <= end < interval.end_s:  # consecutive aversions are joined
            end = interval.end_s
    return float(min([end, *(back for back in cues.returns_s if back > earliest)]))


def sample_dwell_s(averted: bool, state: ContactState, style: SpeakerStyle, rng: np.random.Generator) -> float:
    """Sample how long a look away, or one at the partner, lasts without cues."""
    law, share = _law(state, style)
    odds = share / (1.0 - share) / np.exp(law.logit_share)  # of looking at the partner, relative to an average person
    away_s = law.away_s * style.dwell_scale * odds**-SHARE_EXPONENT
    if averted:
        return float(away_s * rng.lognormal(0.0, law.away_log_sd))
    mean_s = law.look_scale * away_s * share / (1.0 - share) / style.liveliness
    return float(mean_s * rng.lognormal(-(law.look_log_sd**2) / 2.0, law.look_log_sd))


def _law(state: ContactState, style: SpeakerStyle) -> tuple[StateContact, float]:
    """How long people look in a state, and this person's share of gaze at the partner."""
    law = style.contact.states[state]
    if state == "listening":
        return law, style.partner_gaze_listening
    own = style.contact.states["speaking"].logit_share
    return law, float(expit(logit(style.partner_gaze_speaking) + law.logit_share - own))


def _aversion_tendency(style: SpeakerStyle) -> float:
    """Factor of the style on the probability that a cue leads to an aversion: 1 for an average person."""
    share = style.partner_gaze_speaking
    odds = (1.0 - share) / share * np.exp(style.contact.states["speaking"].logit_share)
    return float(np.clip(odds**0.7, 0.3, 1.5))
