"""When somebody looks at the partner and when away, talking and listening: weakly tied to speech, drawn anew each take.

People look away to plan what they say, to hold the floor, and to keep intimacy in bounds (Andrist, Mutlu & Gleicher
2013, whose times and lengths stand below); talkers look away more than listeners do (Argyle & Cook 1976), start to
speak with gaze averted and end with it on the partner (Kendon 1967; Ho, Foulsham & Kingstone 2015). Each such tie is a
coin toss with its own latency, so that sound tells little about gaze, as in life. Times are seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.synthesis.speakers import SpeakerStyle

AversionCause = Literal["planning", "floor", "intimacy"]


@dataclass(frozen=True)
class AversionTiming:
    """When an aversion about an onset of speech starts and ends, as (mean, standard deviation) from that onset."""

    start_s: tuple[float, float]
    end_s: tuple[float, float]


# Andrist et al. mean -1.32 and -1.03 for the starts, measured at onsets after whole turns of the partner.
AVERSION_TIMINGS: dict[AversionCause, AversionTiming] = {
    "planning": AversionTiming((-1.32, 0.60), (1.60, 0.75)),
    "floor": AversionTiming((-0.60, 0.50), (1.00, 0.60)),
}
PLANNING_PROBABILITY, FLOOR_PROBABILITY = 1.0, 0.55
TURN_END_RETURN_PROBABILITY, PAUSE_RETURN_PROBABILITY = 1.0, 0.35
RETURN_LATENCY_S = (-0.6, 0.1)
LISTENER_LATENCY_S = (0.1, 0.6)  # whoever listens looks at the partner soon after the turn has passed
MIN_PAUSE_S = 0.25  # a shorter gap is no end of an utterance
PLANNED_PAUSE_S = 0.5  # behind a longer pause, what is said next has to be planned
INTIMACY_TALKING_S, INTIMACY_LISTENING_S = (1.96, 0.55), (1.14, 0.27)
LOOK_SCALE, LOOK_SHAPE = 1.6, 2.0
LISTENING_SCALE = 2.5  # looks that turns cut short make up for it
AVERAGE_LOOK, AVERSION_STYLE_EXPONENT = 0.55, 0.45
LISTENING_SPREAD = 0.26  # of the looks of a listener (7.21 +- 1.88 s)
MIN_DWELL_S = 0.45
WARM_UP_S = 6.0


@dataclass(frozen=True)
class GazeInterval:
    """A stretch of one gaze state; `cause` is why gaze is averted (without meaning at the partner)."""

    start_s: float
    end_s: float
    averted: bool
    cause: AversionCause = "intimacy"


@dataclass(frozen=True)
class GazeCues:
    """What the speech asks for: stretches of looking away and moments of looking back, ascending."""

    aversions: tuple[GazeInterval, ...]
    returns_s: tuple[float, ...]


def sample_gaze_cues(annotation: Annotation, style: SpeakerStyle, rng: np.random.Generator) -> GazeCues:
    """Toss the coins for starts and ends of utterances; speakers of weak coupling or quiet eyes toss fewer."""
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
    back.extend(span.start_s + rng.uniform(*LISTENER_LATENCY_S) for span in annotation.listening)
    return GazeCues(tuple(sorted(aversions, key=lambda look: look.start_s)), tuple(sorted(back)))


def gaze_intervals(
    annotation: Annotation, style: SpeakerStyle, seconds: float, rng: np.random.Generator
) -> list[GazeInterval]:
    """Gaze states from before the clip (so that it starts amid a conversation) to its end, in turns."""
    cues = sample_gaze_cues(annotation, style, rng)
    time = -WARM_UP_S
    looking = style.partner_gaze_listening if _listens(annotation.listening, time) else style.look
    averted, cause = bool(rng.random() > looking), _cause_at(cues, time)
    states: list[GazeInterval] = []
    while time < seconds:
        listens = _listens(annotation.listening, time)
        end = _end_away(time, cues, listens, style, rng) if averted else _end_looking(time, cues, listens, style, rng)
        states.append(GazeInterval(time, end, averted, cause))
        time, averted = end, not averted
        cause = _cause_at(cues, time)
    return states


def _listens(listening: tuple[Span, ...], time_s: float) -> bool:
    """Whether the partner has the turn; before the clip whoever has it at its start."""
    time_s = max(time_s, 0.0)
    return any(span.start_s <= time_s < span.end_s for span in listening)


def _cause_at(cues: GazeCues, time_s: float) -> AversionCause:
    """Why gaze goes away at a time: as the speech asks, else for no reason in it."""
    for look in cues.aversions:
        if look.start_s <= time_s < look.end_s:
            return look.cause
    return "intimacy"


def _end_looking(time_s: float, cues: GazeCues, listens: bool, style: SpeakerStyle, rng: np.random.Generator) -> float:
    """Until the speech asks to look away, or for as long as people of this style hold a look."""
    earliest = time_s + MIN_DWELL_S
    if listens:
        odds = style.partner_gaze_listening / (1.0 - style.partner_gaze_listening)
        mean_s = LISTENING_SCALE * INTIMACY_LISTENING_S[0] * odds / style.liveliness
        spontaneous_end_s = time_s + mean_s * max(0.1, 1.0 + LISTENING_SPREAD * rng.standard_normal())
    else:
        odds = style.look / (1.0 - style.look)
        mean_s = LOOK_SCALE * INTIMACY_TALKING_S[0] * odds / style.liveliness
        spontaneous_end_s = time_s + rng.gamma(LOOK_SHAPE, mean_s / LOOK_SHAPE)
    wanted = [max(look.start_s, earliest) for look in cues.aversions if look.end_s > earliest + MIN_DWELL_S]
    return float(min([max(spontaneous_end_s, earliest), *wanted]))


def _end_away(time_s: float, cues: GazeCues, listens: bool, style: SpeakerStyle, rng: np.random.Generator) -> float:
    """As long as was asked for or as such aversions last, unless the speech asks to look back before."""
    earliest = time_s + MIN_DWELL_S
    if listens:
        length_s = rng.normal(*INTIMACY_LISTENING_S)
    else:
        length_s = _away_odds(style) ** AVERSION_STYLE_EXPONENT * rng.normal(*INTIMACY_TALKING_S)
    end = max(earliest, time_s + length_s)
    for look in cues.aversions:
        if look.start_s <= time_s < look.end_s:
            end = max(earliest, look.end_s)
        elif time_s < look.start_s <= end < look.end_s:  # one aversion goes over into the next
            end = look.end_s
    return float(min([end, *(back for back in cues.returns_s if back > earliest)]))


def _away_odds(style: SpeakerStyle) -> float:
    """How much more people of a style look away than the average one, who looks 55 % of the time (1: as much)."""
    return (1.0 - style.look) / style.look * AVERAGE_LOOK / (1.0 - AVERAGE_LOOK)


def _aversion_tendency(style: SpeakerStyle) -> float:
    """How much more readily than the average people of a style look away when the speech gives a reason."""
    return float(np.clip(_away_odds(style) ** 0.7, 0.3, 1.5))
