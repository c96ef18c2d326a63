"""When a speaker looks at the partner and when away: weakly tied to what is said, drawn afresh in every take.

Looking away is likely at the start of an utterance (Kendon 1967; Ho, Foulsham & Kingstone 2015) and in pauses,
looking back at its end; everything else runs by dwell times (Lee, Badler & Badler 2002; Andrist et al. 2013). Each
such tie is a coin toss with its own latency, so that sound tells little about gaze, as in life. Times are seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation
from talkingeyes.world.speakers import Style

AVERT_AT_START, AVERT_AT_PAUSE, RETURN_AT_END = 0.85, 0.40, 0.60
START_LATENCY_S = (-0.55, 0.50)
PAUSE_LATENCY_S = (0.0, 0.30)
RETURN_LATENCY_S = (-0.6, 0.1)
LEAST_PAUSE_S = 0.25
PLANNING_S, PLANNING_SPREAD = 1.3, 0.5  # an aversion at the start of an utterance lasts so long into it (Andrist 2013)
AVERSION_S, AVERSION_SPREAD = 1.6, 0.5
HAZARD_PER_S = 0.36
LEAST_DWELL_S = 0.45
WARM_UP_S = 6.0


@dataclass(frozen=True)
class Look:
    """A stretch of one gaze state."""

    start_s: float
    end_s: float
    averted: bool


@dataclass(frozen=True)
class Asked:
    """What the speech asks for: stretches of looking away and moments of looking back, ascending."""

    away: tuple[Look, ...]
    back_s: tuple[float, ...]


def ask(annotation: Annotation, style: Style, random: np.random.Generator) -> Asked:
    """Toss the coins for utterance starts, pauses and ends; speakers of weak coupling toss fewer."""
    away, back = [], []
    for index, span in enumerate(annotation.speaking):
        before_s = span.start_s - annotation.speaking[index - 1].end_s if index else np.inf
        if before_s >= LEAST_PAUSE_S and random.random() < AVERT_AT_START * style.coupling:
            start = span.start_s + random.normal(*START_LATENCY_S)
            away.append(
                Look(start, max(span.start_s, start) + _length(PLANNING_S, PLANNING_SPREAD, style, random), True)
            )
        if random.random() < RETURN_AT_END * style.coupling:
            back.append(span.end_s + random.uniform(*RETURN_LATENCY_S))
    for pause in annotation.pauses:
        if pause.end_s - pause.start_s >= LEAST_PAUSE_S and random.random() < AVERT_AT_PAUSE * style.coupling:
            start = pause.start_s + random.normal(*PAUSE_LATENCY_S)
            away.append(Look(start, start + _length(AVERSION_S, AVERSION_SPREAD, style, random), True))
    return Asked(tuple(sorted(away, key=lambda look: look.start_s)), tuple(sorted(back)))


def looks(annotation: Annotation, style: Style, seconds: float, random: np.random.Generator) -> list[Look]:
    """Gaze states from before the clip (so that it starts amid a conversation) to its end, in turns."""
    asked = ask(annotation, style, random)
    time, averted = -WARM_UP_S, bool(random.random() < 1.0 - style.look)
    states: list[Look] = []
    while time < seconds:
        end = _end_away(time, asked, style, random) if averted else _end_looking(time, asked, style, random)
        states.append(Look(time, end, averted))
        time, averted = end, not averted
    return states


def _end_looking(time_s: float, asked: Asked, style: Style, random: np.random.Generator) -> float:
    """Until the speech asks to look away, or for no reason."""
    earliest = time_s + LEAST_DWELL_S
    unasked = time_s + random.exponential(1.0 / (HAZARD_PER_S * _odds(style) ** 0.8))
    return float(min([max(unasked, earliest), *(look.start_s for look in asked.away if look.start_s > earliest)]))


def _end_away(time_s: float, asked: Asked, style: Style, random: np.random.Generator) -> float:
    """As long as was asked for or as aversions last, unless the speech asks to look back before."""
    earliest = time_s + LEAST_DWELL_S
    end = max(earliest, time_s + _length(AVERSION_S, AVERSION_SPREAD, style, random))
    for look in asked.away:
        if look.start_s <= time_s < look.end_s:
            end = max(earliest, look.end_s)
    return float(min([end, *(back for back in asked.back_s if back > earliest)]))


def _odds(style: Style) -> float:
    return (1.0 - style.look) / style.look


def _length(median_s: float, spread: float, style: Style, random: np.random.Generator) -> float:
    return float(median_s * _odds(style) ** 0.4 * np.exp(spread * random.standard_normal()))
