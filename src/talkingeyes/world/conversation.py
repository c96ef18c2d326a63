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

AVERT_AT_START, AVERT_AT_PAUSE, RETURN_AT_END = 0.70, 0.45, 0.75
START_LATENCY_S = (-0.55, 0.55)
PAUSE_LATENCY_S = (0.0, 0.30)
RETURN_LATENCY_S = (-0.6, 0.1)
LEAST_PAUSE_S = 0.25
HAZARD_PER_S = 0.26
AVERSION_S, AVERSION_SPREAD = 1.75, 0.5
LEAST_DWELL_S = 0.45
WARM_UP_S = 6.0


@dataclass(frozen=True)
class Look:
    """A stretch of one gaze state."""

    start_s: float
    end_s: float
    averted: bool


@dataclass(frozen=True)
class Triggers:
    """Times at which speech asks for looking away and for looking back, ascending."""

    avert_s: tuple[float, ...]
    return_s: tuple[float, ...]


def draw_triggers(annotation: Annotation, coupling: float, random: np.random.Generator) -> Triggers:
    """Toss the coins for utterance starts, pauses and ends; weak speakers toss fewer."""
    avert, back = [], []
    for index, span in enumerate(annotation.speaking):
        before = span.start_s - annotation.speaking[index - 1].end_s if index else np.inf
        if before >= LEAST_PAUSE_S and random.random() < AVERT_AT_START * coupling:
            avert.append(span.start_s + random.normal(*START_LATENCY_S))
        if random.random() < RETURN_AT_END * coupling:
            back.append(span.end_s + random.uniform(*RETURN_LATENCY_S))
    for pause in annotation.pauses:
        if pause.end_s - pause.start_s >= LEAST_PAUSE_S and random.random() < AVERT_AT_PAUSE * coupling:
            avert.append(pause.start_s + random.normal(*PAUSE_LATENCY_S))
    return Triggers(tuple(sorted(avert)), tuple(sorted(back)))


def looks(annotation: Annotation, style: Style, seconds: float, random: np.random.Generator) -> list[Look]:
    """Gaze states from before the clip (so that it starts amid a conversation) to its end."""
    triggers = draw_triggers(annotation, style.coupling, random)
    odds = (1.0 - style.look) / style.look
    time, averted = -WARM_UP_S, bool(random.random() < 1.0 - style.look)
    states = []
    while time < seconds:
        if averted:
            length = AVERSION_S * odds**0.4 * np.exp(AVERSION_SPREAD * random.standard_normal())
            asked = triggers.return_s
        else:
            length = random.exponential(1.0 / (HAZARD_PER_S * odds**0.8))
            asked = triggers.avert_s
        earliest = time + LEAST_DWELL_S
        end = min([max(time + length, earliest), *(each for each in asked if each > earliest)])
        states.append(Look(time, end, averted))
        time, averted = end, not averted
    return states
