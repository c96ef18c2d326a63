"""Sketched clips: true takes without text or voice, with speech as spans, for the validation of metrics.

Motion comes from the generator of takes (take.py), so its statistics are those of a synthetic corpus. No speech is
synthesized, so an hour of clips takes seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.annotation import Annotation, Phoneme, Span
from talkingeyes.core.motion import Motion
from talkingeyes.physiology.blinks import PHYSIOLOGICAL
from talkingeyes.synthesis.speakers import sample_style, with_habits
from talkingeyes.synthesis.take import sample_take

PHONEME_S = 0.09
SPEECH_MEDIAN_S, SPEECH_SPREAD = 1.5, 0.5
GAP_MEDIAN_S, GAP_SPREAD, MIN_GAP_S = 0.5, 0.6, 0.3
# In conversations: the fractions of gaps that are silent hesitations or the partner's turn, and of stretches of speech
# that end in a filler. Choices that give every kind of event often enough to be tested.
HESITATION_FRACTION, TURN_FRACTION, FILLER_FRACTION = 0.4, 0.25, 0.3
TURN_MEDIAN_S, FILLER_S = 2.5, 0.35


@dataclass(frozen=True)
class SketchedClip:
    """One sketched sound, its speaker, and takes of it."""

    speaker: str
    annotation: Annotation
    takes: tuple[Motion, ...]


def sketch_clips(
    speakers: int,
    sounds: int,
    takes: int,
    seconds: float,
    fps: float,
    seed: int,
    population: str | None = None,
    conversation: bool = False,
) -> list[SketchedClip]:
    """Generate `sounds` per speaker and `takes` per sound, with a random generator per speaker and per sound.

    `population`: the recorded population whose gaze the speakers have (physiology/populations); None: the laws of
    synthesis/gaze_shifts.py. `conversation`: with turns of a partner, silent hesitations and fillers. Raises InputError
    for a damaged population file.
    """
    found = []
    for speaker in range(speakers):
        own = np.random.default_rng([seed, speaker])
        style = sample_style(own)
        if population is not None:
            style = with_habits(style, population, own)
        for sound in range(sounds):
            rng = np.random.default_rng([seed, speaker, sound])
            annotation = sketch_annotation(seconds, rng, conversation)
            motions = [sample_take(annotation, style, seconds, rng, PHYSIOLOGICAL) for _ in range(takes)]
            frames = round(seconds * fps)
            found.append(SketchedClip(str(speaker), annotation, tuple(each.motion(fps, frames) for each in motions)))
    return found


def sketch_annotation(seconds: float, rng: np.random.Generator, conversation: bool = False) -> Annotation:
    """Spans of speech and gaps; alternating open and closed phonemes, every third syllable stressed."""
    start_s = rng.uniform(0.2, 1.0)
    speaking: list[Span] = []
    phonemes: list[Phoneme] = []
    pauses, fillers, listening = list[Span](), list[Span](), list[Span]()
    while start_s < seconds - 1.0:
        end_s = min(seconds - 0.1, start_s + SPEECH_MEDIAN_S * np.exp(SPEECH_SPREAD * rng.standard_normal()))
        speaking.append(Span(start_s, end_s))
        for index, onset_s in enumerate(np.arange(start_s, end_s - PHONEME_S, PHONEME_S)):
            symbol = "a" if index % 2 else "t"
            phonemes.append(Phoneme(float(onset_s), float(onset_s + PHONEME_S), symbol, index % 6 == 1))
        gap_s = max(MIN_GAP_S, GAP_MEDIAN_S * np.exp(GAP_SPREAD * rng.standard_normal()))
        if conversation:
            if rng.random() < FILLER_FRACTION:
                fillers.append(Span(max(start_s, end_s - FILLER_S), end_s, "um"))
            kind = rng.random()
            if kind < TURN_FRACTION:
                gap_s += TURN_MEDIAN_S * np.exp(GAP_SPREAD * rng.standard_normal())
                listening.append(Span(end_s, end_s + gap_s))
            elif kind < TURN_FRACTION + HESITATION_FRACTION:
                pauses.append(Span(end_s, end_s + gap_s, "hesitation"))
        start_s = end_s + gap_s
    return Annotation(
        phonemes=tuple(phonemes),
        speaking=tuple(speaking),
        listening=tuple(listening),
        pauses=tuple(pauses),
        fillers=tuple(fillers),
    )
