"""Phrases synthesized one by one with espeak-ng, trimmed to the audible part, with word and phoneme times.

Pauses do not come from espeak: a sentence is split into runs of words, fillers and silences of exactly the length in
the script. Pure: reads and writes no files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Phoneme, Span
from talkingeyes.synthesis.espeak import ESPEAK_SAMPLE_RATE, PHONEME, WORD, EspeakOutput, SpeakFunction
from talkingeyes.synthesis.text import Filler, Pause, SpeechUnit, Word
from talkingeyes.synthesis.voice_profiles import Voice

FADE_S = 0.004
TRIM_LEVEL = 10 ** (-42 / 20)
FILLER_RATE = 0.7  # fillers are lengthened
PUNCTUATION = " .,?!¿"
PROMINENCE_DB = 12.0  # half to full prominence corresponds to 6 dB above the median stressed vowel of the phrase
NUCLEUS = 0.8


@dataclass(frozen=True)
class Phrase:
    """Words without a pause between them, or one filler."""

    text: str
    filler: bool = False


@dataclass(frozen=True)
class SpokenPhrase:
    """A synthesized phrase; times in seconds from its start."""

    sound: Float[ndarray, " N"]
    words: tuple[Span, ...]
    phonemes: tuple[Phoneme, ...]
    filler: str


def split_phrases(parts: Sequence[SpeechUnit]) -> list[Phrase | Pause]:
    """Split a sentence into runs of words, fillers and pauses.

    An interrupted run gets a comma, so that its intonation stays up.
    """
    found: list[Phrase | Pause] = []
    words: list[str] = []

    def flush() -> None:
        if words:
            text = " ".join(words)
            found.append(Phrase(text if text[-1] in PUNCTUATION else text + ","))
            words.clear()

    for part in parts:
        if isinstance(part, Word):
            words.append(part.text)
            continue
        flush()
        found.append(Phrase(part.text + ",", filler=True) if isinstance(part, Filler) else part)
    flush()
    return found


def speak_phrase(say: SpeakFunction, phrase: Phrase, voice: Voice) -> SpokenPhrase:
    """Synthesize a phrase and trim espeak's padding by level, so that all other silence comes from the script."""
    rate_wpm = round(voice.rate_wpm * (FILLER_RATE if phrase.filler else 1))
    raw = say(phrase.text, rate_wpm, voice.pitch, voice.pitch_range)
    level = np.abs(raw.sound)
    loud = level > TRIM_LEVEL * level.max(initial=1e-6)
    fade = round(FADE_S * ESPEAK_SAMPLE_RATE)
    start = max(int(loud.argmax()) - fade, 0)
    stop = min(len(loud) - 1 - int(loud[::-1].argmax()) + fade, len(loud))
    sound = raw.sound[start:stop].copy()
    ramp = np.sin(np.linspace(0, np.pi / 2, fade)) ** 2
    sound[:fade] *= ramp
    sound[-fade:] *= ramp[::-1]
    phonemes, words = _timings(raw, phrase.text, start, stop)
    return SpokenPhrase(
        sound, words, _with_prominence(phonemes, sound), phrase.text.strip(PUNCTUATION) if phrase.filler else ""
    )


def _with_prominence(phonemes: tuple[Phoneme, ...], sound: Float[ndarray, " N"]) -> tuple[Phoneme, ...]:
    """Set the prominence of stressed vowels from their level in the phrase; the last one is always accented."""
    stressed = [index for index, phoneme in enumerate(phonemes) if phoneme.stressed]
    if not stressed:
        return phonemes
    level_db = np.array([_level_db(phonemes[index], sound) for index in stressed])
    above = np.clip(0.5 + (level_db - np.median(level_db)) / PROMINENCE_DB, 0.0, 1.0)
    above[-1] = max(above[-1], NUCLEUS)
    found = list(phonemes)
    for index, prominence in zip(stressed, above, strict=True):
        found[index] = replace(phonemes[index], prominence=round(float(prominence), 3))
    return tuple(found)


def _level_db(phoneme: Phoneme, sound: Float[ndarray, " N"]) -> float:
    piece = sound[round(phoneme.start_s * ESPEAK_SAMPLE_RATE) : round(phoneme.end_s * ESPEAK_SAMPLE_RATE)]
    return float(10 * np.log10(piece @ piece / max(len(piece), 1) + 1e-12))


def _timings(raw: EspeakOutput, text: str, start: int, stop: int) -> tuple[tuple[Phoneme, ...], tuple[Span, ...]]:
    """Phonemes and words in seconds from sample `start`. A word extends from its first to its last phoneme."""
    ends = [*[event.sample for event in raw.events if event.kind == PHONEME][1:], stop]
    phonemes: list[Phoneme] = []
    positions: list[int] = []
    first_of: list[int] = []
    following = iter(ends)
    for event in raw.events:
        if event.kind == WORD:
            at = event.text_position - 1
            if not text[max(at - 1, 0) : at].isalnum():  # espeak reports "most of" as m, ost, of
                positions.append(at)
                first_of.append(len(phonemes))
            continue
        begin_s, end_s = (
            (min(max(at, start), stop) - start) / ESPEAK_SAMPLE_RATE for at in (event.sample, next(following))
        )
        symbol = event.symbol.lstrip("',%=")
        if symbol == ";" and phonemes:  # a palatal glide into the next sound, not a phoneme
            phonemes[-1] = Phoneme(phonemes[-1].start_s, end_s, phonemes[-1].symbol, phonemes[-1].stressed)
        elif end_s > begin_s and not symbol.startswith(("_", "|")) and symbol:
            phonemes.append(Phoneme(begin_s, end_s, symbol, event.symbol.startswith("'")))
    words = []
    for (i, j), (a, b) in zip(pairwise([*first_of, len(phonemes)]), pairwise([*positions, len(text)]), strict=True):
        if j > i:
            words.append(Span(phonemes[i].start_s, phonemes[j - 1].end_s, text[a:b].strip(PUNCTUATION)))
    return tuple(phonemes), tuple(words)
