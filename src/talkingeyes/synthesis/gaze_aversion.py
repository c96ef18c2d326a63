"""Timing of gaze at the partner and gaze aversion while talking and listening, sampled anew for each take.

People avert gaze to plan what they say, to hold the floor, and to regulate intimacy (Andrist, Mutlu & Gleicher 2013,
who give the onsets and durations used below). Speakers avert gaze more than listeners do (Argyle & Cook 1976), start to
speak with averted gaze and end with gaze at the partner (Kendon 1967; Ho, Foulsham & Kingstone 2015), and look away
when they hesitate: Kendon (1967) reports gaze at the partner in 50 % of fluent and 20 % of hesitant speech. Fillers
alone do not reliably come with averted gaze (Jehoul et al.), so only silent hesitations are cues. Each of these
couplings is a random event with its own latency, so speech predicts gaze only weakly, as in humans. Times are in
seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.synthesis.speakers import SpeakerStyle

AversionCause = Literal["planning", "floor", "intimacy"]


@dataclass(frozen=True)
class AversionTiming:
    """Start and end of an aversion relative to an onset of speech, each as (mean, standard deviation)."""

    start_s: tuple[float, float]
    end_s: tuple[float, float]


# Andrist et al. report means of -1.32 and -1.03 s for the starts, at onsets after whole turns of the partner.
AVERSION_TIMINGS: dict[AversionCause, AversionTiming] = {
    "planning": AversionTiming((-1.32, 0.60), (1.60, 0.75)),
    "floor": AversionTiming((-0.60, 0.50), (1.00, 0.60)),
}
PLANNING_PROBABILITY, FLOOR_PROBABILITY = 1.0, 0.55
# Our choices: gaze is at the partner in 36 % of the time of silent hesitations, 57 % otherwise; Kendon's figures are of
# few dyads. The timing is relative to start and end of the pause.
HESITATION_PROBABILITY = 0.9
HESITATION_TIMING = AversionTiming((-0.30, 0.30), (0.60, 0.40))
TURN_END_RETURN_PROBABILITY, PAUSE_RETURN_PROBABILITY = 1.0, 0.35
RETURN_LATENCY_S = (-0.6, 0.1)
LISTENER_LATENCY_S = (0.1, 0.6)  # a listener looks at the partner soon after the turn has passed
MIN_PAUSE_S = 0.25  # shorter gaps do not end an utterance
PLANNED_PAUSE_S = 0.5  # after longer pauses, the next utterance is planned
INTIMACY_TALKING_S, INTIMACY_LISTENING_S = (1.96, 0.55), (1.14, 0.27)
LOOK_SCALE, LOOK_SHAPE = 1.6, 2.0
LISTENING_SCALE = 2.5  # compensates for gaze intervals cut short by turns
AVERAGE_PARTNER_GAZE, AVERSION_STYLE_EXPONENT = 0.55, 0.45
LISTENING_SPREAD = 0.26  # relative standard deviation of gaze intervals of a listener (7.21 +- 1.88 s)
MIN_DWELL_S = 0.45
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
    lively = style.speech_coupling * min(1.0, style.liveliness)
    spans = annotation.speaking
    for index, span in enumerate(spans):
        before_s = span.start_s - spans[index - 1].end_s if index else np.inf
        after_s = spans[index + 1].start_s - span.end_s if index + 1 < len(spans) else np.inf
        cause: AversionCause = "planning" if before_s >= PLANNED_PAUSE_S else "floor"
        chance = PLANNING_PROBABILITY if cause == "planning" else FLOOR_PROBABILITY
        if before_s >= MIN_PAUSE_S and rng.random() < chance * lively * _aversion_tendency(style):
            timing = AVERSION_TIMINGS[cause]
            start, end = (span.start_s + rng.normal(*each) for each in (timing.start_s, timing.end_s))
            aversions.append(GazeInterval(start, max(end, start + MIN_DWELL_S), True, cause))
        chance = TURN_END_RETURN_PROBABILITY if after_s >= PLANNED_PAUSE_S else PAUSE_RETURN_PROBABILITY
        if after_s >= MIN_PAUSE_S and rng.random() < chance * (0.3 + 0.7 * style.speech_coupling):
            back.append(span.end_s + rng.uniform(*RETURN_LATENCY_S))
    for pause in annotation.pauses:
        if pause.label == "hesitation" and rng.random() < HESITATION_PROBABILITY * lively * _aversion_tendency(style):
            start = pause.start_s + rng.normal(*HESITATION_TIMING.start_s)
            end = pause.end_s + rng.normal(*HESITATION_TIMING.end_s)
            aversions.append(GazeInterval(start, max(end, start + MIN_DWELL_S), True, "planning"))
    back.extend(span.start_s + rng.uniform(*LISTENER_LATENCY_S) for span in annotation.listening)
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
    looking = style.partner_gaze_listening if listens(annotation.listening, time) else style.partner_gaze_speaking
    averted, cause = bool(rng.random() > looking), _cause_at(cues, time)
    states: list[GazeInterval] = []
    while time < seconds:
        listening = listens(annotation.listening, time)
        end = (
            _end_away(time, cues, listening, style, rng) if averted else _end_looking(time, cues, listening, style, rng)
        )
        states.append(GazeInterval(time, end, averted, cause))
        time, averted = end, not averted
        cause = _cause_at(cues, time)
    return states


def listens(listening: tuple[Span, ...], time_s: float) -> bool:
    """Whether the partner has the turn."""
    return any(span.start_s <= time_s < span.end_s for span in listening)


def _cause_at(cues: GazeCues, time_s: float) -> AversionCause:
    """Cause of an aversion that starts at a time: that of the cue, or intimacy without a cue."""
    for interval in cues.aversions:
        if interval.start_s <= time_s < interval.end_s:
            return interval.cause
    return "intimacy"


def _end_looking(
    time_s: float, cues: GazeCues, listening: bool, style: SpeakerStyle, rng: np.random.Generator
) -> float:
    """End of an interval of gaze at the partner: the next aversion cue, or a duration sampled for the style."""
    earliest = time_s + MIN_DWELL_S
    if listening:
        odds = style.partner_gaze_listening / (1.0 - style.partner_gaze_listening)
        mean_s = LISTENING_SCALE * INTIMACY_LISTENING_S[0] * odds / style.liveliness
        spontaneous_end_s = time_s + mean_s * max(0.1, 1.0 + LISTENING_SPREAD * rng.standard_normal())
    else:
        odds = style.partner_gaze_speaking / (1.0 - style.partner_gaze_speaking)
        mean_s = LOOK_SCALE * INTIMACY_TALKING_S[0] * odds / style.liveliness
        spontaneous_end_s = time_s + rng.gamma(LOOK_SHAPE, mean_s / LOOK_SHAPE)
    wanted = [max(interval.start_s, earliest) for interval in cues.aversions if interval.end_s > earliest + MIN_DWELL_S]
    return float(min([max(spontaneous_end_s, earliest), *wanted]))


def _end_away(time_s: float, cues: GazeCues, listening: bool, style: SpeakerStyle, rng: np.random.Generator) -> float:
    """End of an aversion: that of its cue or a sampled duration, or an earlier return cue."""
    earliest = time_s + MIN_DWELL_S
    if listening:
        length_s = rng.normal(*INTIMACY_LISTENING_S)
    else:
        length_s = _away_odds(style) ** AVERSION_STYLE_EXPONENT * rng.normal(*INTIMACY_TALKING_S)
    end = max(earliest, time_s + length_s)
    for interval in cues.aversions:
        if interval.start_s <= time_s < interval.end_s:
            end = max(earliest, interval.end_s)
        elif time_s < interval.start_s <= end < interval.end_s:  # consecutive aversions are joined
            end = interval.end_s
    return float(min([end, *(back for back in cues.returns_s if back > earliest)]))


def _away_odds(style: SpeakerStyle) -> float:
    """Odds of looking away relative to an average person, who looks at the partner 55 % of the time."""
    return (
        (1.0 - style.partner_gaze_speaking)
        / style.partner_gaze_speaking
        * AVERAGE_PARTNER_GAZE
        / (1.0 - AVERAGE_PARTNER_GAZE)
    )


def _aversion_tendency(style: SpeakerStyle) -> float:
    """Factor of the style on the probability that a cue leads to an aversion."""
    return float(np.clip(_away_odds(style) ** 0.7, 0.3, 1.5))
