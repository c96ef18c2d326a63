"""Listening behaviour in a conversation, sampled from the times at which the two speakers have the turn.

The model receives the subject's speech alone; head and gaze during the subject's own silence are learnt (part of the
corpus is turn-taking conversation). The response to the partner is rule-based, with the distributions of the synthetic
data: in the partner's turns gaze is at the partner for a fraction of time sampled per person (mean 0.82; Argyle & Cook
1976: 0.75, Lee, Badler & Badler 2002: 0.95), and nods answer the partner's phrases. At the start of a turn gaze is
averted (Kendon 1967; Ho, Foulsham & Kingstone 2015) more often than the model does alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.turn_taking import long_turn_starts
from talkingeyes.core.motion import HeadMovement
from talkingeyes.synthesis import head_gestures
from talkingeyes.synthesis.gaze_aversion import AVERSION_TIMINGS
from talkingeyes.synthesis.speakers import LOOK_LISTENING, sample_style

GAZE_FRACTION_LIMITS = (0.5, 0.98)
# Probability that gaze is averted by rule at the start of a long turn; the model decides the others. Together that is
# 0.7 on the sounds of train, as Kendon found for long utterances; the model alone has 0.46.
AVERSION_PROBABILITY = 0.55


@dataclass(frozen=True)
class ListeningBehaviour:
    """The fraction of listening time with gaze at the partner, nods, and spans in which gaze is averted."""

    gaze_fraction: float
    nods: tuple[HeadMovement, ...]
    aversions: tuple[Span, ...]


def sample_listening_behaviour(turns: Annotation, seeds: Sequence[int]) -> ListeningBehaviour:
    """Sample the listening behaviour of one person in a conversation with these turns."""
    rng = np.random.default_rng(seeds)
    style = sample_style(rng)
    gaze_fraction = float(np.clip(rng.beta(*LOOK_LISTENING), *GAZE_FRACTION_LIMITS))
    nods = tuple(head_gestures.listener_nods(turns, style, rng))
    return ListeningBehaviour(gaze_fraction, nods, tuple(_sample_aversions(long_turn_starts(turns), rng)))


def _sample_aversions(starts_s: Sequence[float], rng: np.random.Generator) -> list[Span]:
    """Spans around some turn starts, timed as gaze aversion during speech planning (Andrist et al. 2013)."""
    timing = AVERSION_TIMINGS["planning"]
    spans = [Span(start + rng.normal(*timing.start_s), start + rng.normal(*timing.end_s)) for start in starts_s]
    return [span for span in spans if rng.random() < AVERSION_PROBABILITY]
