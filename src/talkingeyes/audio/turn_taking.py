"""Who speaks and who has the turn in a conversation, from the sound of each of the two speakers."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.voice_activity import detect_speech

# The partner keeps the turn for this long after speaking, unless the subject starts to speak.
TURN_S = 1.0
MIN_TURN_S = 0.6


def detect_turns(own: Float[ndarray, " N"], partner: Float[ndarray, " M"]) -> Annotation:
    """Detect speech of both by level alone (16 kHz), and the spans in which the partner has the turn."""
    speaking, partner_speaking = (detect_speech(sound).speaking for sound in (own, partner))
    held: list[Span] = []
    for span in partner_speaking:
        if held and span.start_s - held[-1].end_s <= TURN_S:
            held[-1] = Span(held[-1].start_s, span.end_s)
        else:
            held.append(span)
    free = [rest for span in held for rest in _subtract(Span(span.start_s, span.end_s + TURN_S / 2), speaking)]
    listening = tuple(span for span in free if span.end_s - span.start_s >= MIN_TURN_S)
    return Annotation(speaking=speaking, listening=listening, partner=partner_speaking)


def _subtract(span: Span, others: Sequence[Span]) -> list[Span]:
    """The parts of a span outside others, which are in order of time."""
    parts, start_s = [], span.start_s
    for other in others:
        if other.end_s > start_s and other.start_s < span.end_s:
            parts.append(Span(start_s, other.start_s))
            start_s = other.end_s
    parts.append(Span(start_s, span.end_s))
    return [part for part in parts if part.end_s > part.start_s]
