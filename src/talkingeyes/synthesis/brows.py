"""Brow raises: on some prominent syllables, at the end of some questions, and occasionally without cause.

The coupling to speech is weak, and sampled anew in every take: brows rise with a minority of accents, slightly before
them (Cave et al. 1996; Flecha-Garcia 2010: 60 ms), and more often in questions. Sizes and probabilities are choices of
this project [U]. Times are in seconds.
"""

from __future__ import annotations

import numpy as np

from talkingeyes.audio.annotation import Annotation
from talkingeyes.physiology.face import BrowRaise

ACCENT_PROBABILITY, QUESTION_PROBABILITY, SPONTANEOUS_PER_S = (
    0.25,
    0.45,
    0.03,
)  # probability at full prominence; of a question; hazard
LEAD_S = (0.06, 0.08)
ACCENT_SIZE, QUESTION_SIZE, SPREAD = 0.35, 0.45, 0.4
QUESTION_S = 0.6  # how long before the end of a question its raise starts


def sample_brow_raises(
    annotation: Annotation, speech_coupling: float, seconds: float, rng: np.random.Generator
) -> tuple[BrowRaise, ...]:
    """Sample brow raises in order of onset; `speech_coupling` scales the probability of raises tied to speech."""
    raises = []
    for phoneme in annotation.phonemes:
        if rng.random() < ACCENT_PROBABILITY * phoneme.prominence * speech_coupling:
            raises.append(_raise(phoneme.start_s - rng.normal(*LEAD_S), ACCENT_SIZE, rng))
    for sentence in annotation.sentences:
        if sentence.label == "question" and rng.random() < QUESTION_PROBABILITY * speech_coupling:
            start_s = max(sentence.start_s, sentence.end_s - QUESTION_S + rng.normal(0.0, 0.2))
            raises.append(_raise(start_s, QUESTION_SIZE, rng, hold_s=0.4))
    for onset_s in rng.uniform(0.0, seconds, rng.poisson(SPONTANEOUS_PER_S * seconds)):
        raises.append(_raise(float(onset_s), ACCENT_SIZE, rng))
    return tuple(sorted(raises, key=lambda one: one.onset_s))


def _raise(onset_s: float, size: float, rng: np.random.Generator, hold_s: float = 0.12) -> BrowRaise:
    return BrowRaise(
        onset_s=float(onset_s),
        rise_s=float(np.clip(rng.normal(0.18, 0.04), 0.1, 0.3)),
        hold_s=float(hold_s * np.exp(SPREAD * rng.standard_normal())),
        fall_s=float(np.clip(rng.normal(0.30, 0.06), 0.15, 0.5)),
        size=float(min(size * np.exp(SPREAD * rng.standard_normal()), 1.0)),
    )
