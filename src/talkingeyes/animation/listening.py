"""What a partner's speech does to whoever listens: rules of conversation laid over what the model does in silence.

The model hears the subject alone; how head and eyes behave in the subject's own silence is learnt (a part of the corpus
is talk by turns). That they heed the partner is a rule, from the same laws as the synthetic world (FACTS, sections 3
and 4): in the partner's turns gaze is at the partner for a share that is drawn for each person (mean .82; Argyle & Cook
1976: 75 %, Lee, Badler & Badler 2002: 95 %), phrases of the partner are answered by nods, and blinks come at the ends
of phrases, one's own and the partner's (Nakano & Kitazawa 2010). Gaze is averted as the turn is taken (Kendon 1967;
Ho, Foulsham & Kingstone 2015), in some more cases than the model has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.audio.waveform import SILENT_DBFS, loudest_dbfs
from talkingeyes.core.motion import HeadMovement
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.gaze_aversion import AVERSION_TIMINGS
from talkingeyes.synthesis.speakers import LOOK_LISTENING, sample_style

# The partner has the turn until this long after speaking, unless the subject begins before.
TURN_S = 1.0
MIN_TURN_S = 0.6
# Turns that are taken from the partner begin averted in so many cases, and in the others as the model has it: in all
# that is seven of ten on the sounds of train, as Kendon found for long utterances; the model alone has .46.
AVERSION_PROBABILITY, LONG_TURN_S = 0.55, 2.0


@dataclass(frozen=True)
class ListeningBehaviour:
    """When each of the two speaks and who has the turn; the share of listening time that gaze is at the partner.

    `aversions` is when gaze is away from the partner, whatever the model has, because the turn is taken.
    """

    annotation: Annotation
    gaze_fraction: float
    nods: tuple[HeadMovement, ...]
    aversions: tuple[Span, ...]


def listening_behaviour(
    own: Float[ndarray, " N"], partner: Float[ndarray, " M"], seeds: Sequence[int]
) -> ListeningBehaviour:
    """What a person does about a partner's speech (16 kHz, beginning at the same time as the own)."""
    rng = np.random.default_rng(seeds)
    annotation = detect_turns(own, partner)
    style = sample_style(rng)
    gaze_fraction = float(np.clip(rng.beta(*LOOK_LISTENING), 0.5, 0.98))
    nods = tuple(head_gestures.backchannels(annotation, style, rng))
    return ListeningBehaviour(annotation, gaze_fraction, nods, tuple(_sample_aversions(turn_starts(annotation), rng)))


def detect_turns(own: Float[ndarray, " N"], partner: Float[ndarray, " M"]) -> Annotation:
    """Who speaks when, by level alone, and the stretches in which the partner has the turn."""
    mine, theirs = _detect_speech(own), _detect_speech(partner)
    held: list[Span] = []
    for span in theirs:
        if held and span.start_s - held[-1].end_s <= TURN_S:
            held[-1] = Span(held[-1].start_s, span.end_s)
        else:
            held.append(span)
    free = [rest for span in held for rest in _without(Span(span.start_s, span.end_s + TURN_S / 2), mine)]
    listens = tuple(span for span in free if span.end_s - span.start_s >= MIN_TURN_S)
    return Annotation(speaking=mine, listening=listens, partner=theirs)


def turn_starts(annotation: Annotation) -> list[float]:
    """When the subject begins long turns that follow the partner's."""
    listens, found = annotation.listening, []
    for index, partner_span in enumerate(listens):
        following_s = listens[index + 1].start_s if index + 1 < len(listens) else np.inf
        own = [span for span in annotation.speaking if partner_span.end_s <= span.start_s < following_s]
        if own and own[-1].end_s - own[0].start_s >= LONG_TURN_S:
            found.append(own[0].start_s)
    return found


def _sample_aversions(starts_s: Sequence[float], rng: np.random.Generator) -> list[Span]:
    """From before some of the starts until after them, as people plan what they say (Andrist et al. 2013)."""
    timing = AVERSION_TIMINGS["planning"]
    spans = [Span(start + rng.normal(*timing.start_s), start + rng.normal(*timing.end_s)) for start in starts_s]
    return [span for span in spans if rng.random() < AVERSION_PROBABILITY]


def _detect_speech(sound: Float[ndarray, " N"]) -> tuple[Span, ...]:
    """Where a sound speaks; nowhere if it is silent, which `speaking` would not know."""
    return () if not len(sound) or loudest_dbfs(sound) < SILENT_DBFS else detect_speech(sound).speaking


def _without(span: Span, others: Sequence[Span]) -> list[Span]:
    """What is left of a span outside others, which are in order of time."""
    left, start = [], span.start_s
    for other in others:
        if other.end_s > start and other.start_s < span.end_s:
            left.append(Span(start, other.start_s))
            start = other.end_s
    left.append(Span(start, span.end_s))
    return [each for each in left if each.end_s > each.start_s]
