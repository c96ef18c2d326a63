"""Voices: accents of seven languages times variants of espeak-ng, with a rate, a pitch and a pitch range.

Emotions change rate, pitch, range and loudness in the directions found for actors (Banse & Scherer 1996, J Pers Soc
Psychol 70(3), Table 6; Juslin & Laukka 2003, Psychol Bull 129(5), Table 7; surprise as in Murray & Arnott 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from talkingeyes.audio.annotation import INTENSITIES
from talkingeyes.core.errors import InputError

ACCENTS: dict[str, tuple[str, ...]] = {
    "en": ("en-us", "en", "en-gb-scotland", "en-gb-x-rp", "en-gb-x-gbclan", "en-gb-x-gbcwmd", "en-029", "en-us-nyc"),
    "fr": ("fr", "fr-be", "fr-ch"),
    "de": ("de",),
    "es": ("es", "es-419"),
    "it": ("it",),
    "pt": ("pt", "pt-br"),
    "nl": ("nl",),
}
VARIANTS = ("m1", "m2", "m3", "m4", "m5", "m6", "m7", "m8", "f1", "f2", "f3", "f4", "f5", "Andy", "Alicia", "Annie")
VOICE_NAMES = (
    f"accent+variant, of the accents {', '.join(accent for accents in ACCENTS.values() for accent in accents)} and "
    f"the variants {', '.join(VARIANTS)}"
)
RATES_WPM = (145, 195)
PITCHES = (30, 70)
PITCH_RANGES = (35, 80)
PITCH_STEPS = 50 / 12  # steps of espeak's pitch per semitone: 50 steps double the frequency
ESPEAK_MAX = 99


@dataclass(frozen=True)
class Voice:
    """A voice of espeak-ng: `espeak_voice` is accent+variant; pitch and pitch_range are espeak's 0 to 99."""

    name: str
    language: str
    espeak_voice: str
    rate_wpm: int
    pitch: int
    pitch_range: int
    level_db: float = 0.0


@dataclass(frozen=True)
class ProsodyFactors:
    """Effect of an emotion on a voice: factors on rate and pitch range, semitones of pitch, decibels."""

    rate: float = 1.0
    pitch_semitones: float = 0.0
    pitch_range: float = 1.0
    level_db: float = 0.0


# At the highest intensity. Directions are from the literature; sizes are choices within the ranges of actors.
EMOTION_PROSODY = {
    "neutral": ProsodyFactors(),
    "happy": ProsodyFactors(1.10, 3.0, 1.5, 3.0),
    "sad": ProsodyFactors(0.80, -2.0, 0.6, -5.0),
    "surprised": ProsodyFactors(1.06, 4.0, 1.6, 2.0),
    "fear": ProsodyFactors(1.15, 3.5, 0.8, -2.0),
    "disgusted": ProsodyFactors(0.88, -1.5, 0.85, -1.0),
    "angry": ProsodyFactors(1.12, 2.0, 1.4, 5.0),
    "contempt": ProsodyFactors(0.90, -2.0, 0.75, -2.0),
}


def sample_voice(rng: np.random.Generator, language: str, among: Sequence[str] = ()) -> Voice:
    """Sample a voice for a language, from `among` if given. Raises InputError if there is none."""
    if language not in ACCENTS:
        raise InputError(f"voices: language should be one of {', '.join(ACCENTS)}, got {language!r}")
    named = [each for each in among if each.partition("+")[0] in ACCENTS[language]]
    if among and not named:
        raise InputError(f"voices: should have one for {language} ({', '.join(ACCENTS[language])}), got {list(among)}")
    accents = ACCENTS[language]
    espeak_voice = str(rng.choice(named) if named else f"{rng.choice(accents)}+{rng.choice(VARIANTS)}")
    rate, pitch, pitch_range = (int(rng.integers(a, b + 1)) for a, b in (RATES_WPM, PITCHES, PITCH_RANGES))
    return Voice(f"{espeak_voice}-{rate}-{pitch}-{pitch_range}", language, espeak_voice, rate, pitch, pitch_range)


def is_voice(espeak_voice: str) -> bool:
    """Whether this is the name of a voice."""
    accent, _, variant = espeak_voice.partition("+")
    return variant in VARIANTS and any(accent in accents for accents in ACCENTS.values())


def apply_emotion(voice: Voice, emotion: str, intensity: int) -> Voice:
    """Apply an emotion of intensity 0 (none) to 3 to a voice. Raises InputError for an unknown emotion."""
    if emotion not in EMOTION_PROSODY:
        raise InputError(f"emotion: should be one of {', '.join(EMOTION_PROSODY)}, got {emotion!r}")
    factors, part = EMOTION_PROSODY[emotion], intensity / INTENSITIES[-1]
    return replace(
        voice,
        rate_wpm=round(voice.rate_wpm * factors.rate**part),
        pitch=round(min(max(voice.pitch + PITCH_STEPS * factors.pitch_semitones * part, 0), ESPEAK_MAX)),
        pitch_range=round(min(voice.pitch_range * factors.pitch_range**part, ESPEAK_MAX)),
        level_db=factors.level_db * part,
    )
