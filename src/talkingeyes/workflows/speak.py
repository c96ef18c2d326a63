"""Text to speech: `talkingeyes animate --text` and `talkingeyes.speak`.

The synthesiser is that of the synthetic data (synthesis/speech_synthesis.py; the extra `synthesis`), so times of words
and phonemes are known. A text is split at its punctuation; the pauses are medians of human pauses (synthesis/text.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    from talkingeyes.synthesis.text import Script, Sentence, SpeechUnit
    from talkingeyes.synthesis.voice_profiles import Voice

DEFAULT_LANGUAGE = "en"
DEFAULT_VARIANT = "f3"
RATE_WPM, PITCH, PITCH_RANGE = 170, 50, 55  # the project's default rate, the middle of the pitch range
MAX_CHARACTERS = 50_000  # less than an hour at the slowest rate
SENTENCE = re.compile(r"(?<=[.?!…])[\"'”’»)]*\s+|\n+")
CLAUSE_ENDS = ",;:–—"
PCM_16 = 32768


@dataclass(frozen=True)
class SynthesizedSpeech:
    """Sound (16 kHz, at 16-bit precision), the times of its words and phonemes, and the text."""

    sound: Float[ndarray, " N"]
    annotation: Annotation
    text: str
    voice: str

    def save(self, path: Path | str) -> None:
        """Write the sound as a wav, and its words and phonemes beside it (NAME.json, in the format of corpus
        annotations)."""
        import soundfile

        path = Path(path)
        soundfile.write(path, np.round(self.sound * PCM_16).astype(np.int16), 16_000, "PCM_16", format="WAV")
        self.annotation.save(path.with_suffix(".json"))


def speak(
    text: str, *, voice: str | None = None, language: str | None = None, emotion: str = "neutral", intensity: int = 0
) -> SynthesizedSpeech:
    """Synthesize a text. The same text and voice give the same bytes.

    `voice` is an accent and a variant of espeak-ng (en-us+f3). The language follows from it, or selects a default
    voice. An emotion with an intensity from 1 to 3 modifies the voice as in the synthetic data, and is stored in the
    annotation.

    Raises InputError (one line) for a text without words, and for an unknown voice or language.
    """
    if find_spec("espeakng_loader") is None:
        raise InputError("text: should have the package espeakng-loader installed (the extra `synthesis`), got none")
    from talkingeyes.synthesis.speech_synthesis import synthesize_script
    from talkingeyes.synthesis.voice_profiles import apply_emotion

    chosen = select_voice(voice, language)
    script = parse_script(text, chosen.language)
    bent = apply_emotion(chosen, emotion, intensity)
    try:
        spoken = synthesize_script(script, bent)
    except (ValueError, IndexError, ZeroDivisionError):  # symbols that espeak cannot speak
        spoken = None
    if spoken is None or not np.isfinite(spoken.sound).all() or not spoken.annotation.phonemes:
        raise InputError(f"text: should be words that {chosen.espeak_voice} can speak, got {_short(text)}")
    annotation = replace(spoken.annotation, emotion=emotion, intensity=intensity)
    steps = np.clip(np.round(spoken.sound.astype(np.float64) * PCM_16), -PCM_16, PCM_16 - 1)
    return SynthesizedSpeech((steps / PCM_16).astype(np.float32), annotation, text, chosen.espeak_voice)


def select_voice(voice: str | None, language: str | None) -> Voice:
    """The voice of a name, or the default voice of a language."""
    from talkingeyes.synthesis.voice_profiles import ACCENTS, VOICE_NAMES, Voice, is_voice

    if language is not None and language not in ACCENTS:
        raise InputError(f"language: should be one of {', '.join(ACCENTS)}, got {language!r}")
    if voice is None:
        language = language or DEFAULT_LANGUAGE
        voice = f"{ACCENTS[language][0]}+{DEFAULT_VARIANT}"
    elif not is_voice(voice):
        raise InputError(f"voice: should be {VOICE_NAMES}, got {voice!r}")
    spoken = next(each for each, accents in ACCENTS.items() if voice.partition("+")[0] in accents)
    if language not in (None, spoken):
        raise InputError(
            f"voice: should be one of the language {language} ({', '.join(ACCENTS[language])}), got {voice}"
        )
    return Voice(voice, spoken, voice, RATE_WPM, PITCH, PITCH_RANGE)


def parse_script(text: str, language: str) -> Script:
    """A text as a script: sentences of words and fillers, with a pause at every comma and full stop."""
    from talkingeyes.synthesis.text import Script, without_last_pause

    if len(text) > MAX_CHARACTERS:
        raise InputError(f"text: should be at most {MAX_CHARACTERS} characters, got {len(text)}; split it into parts")
    sentences = [_sentence(each, language) for each in SENTENCE.split(text) if re.search(r"\w", each)]
    if not sentences or "\0" in text:
        raise InputError(f"text: should hold words, got {_short(text)}")
    sentences[-1] = without_last_pause(sentences[-1])
    return Script(language, tuple(sentences))


def _sentence(text: str, language: str) -> Sentence:
    from talkingeyes.synthesis.grammar import GRAMMARS
    from talkingeyes.synthesis.text import PAUSES, Filler, Pause, Sentence, Word

    fillers = {each.lower() for each in GRAMMARS[language]["filler"]}
    parts: list[SpeechUnit] = []
    for token in text.split():
        if not re.search(r"\w", token):  # a dash alone: a pause after the previous word
            if parts and isinstance(parts[-1], Word):
                parts.append(Pause("comma", PAUSES["comma"][0]))
            continue
        bare = token.strip(".,;:?!…–—\"'”’»)").lower()
        parts.append(Filler(bare) if bare in fillers else Word(token))
        if token[-1] in CLAUSE_ENDS:
            parts.append(Pause("comma", PAUSES["comma"][0]))
    if isinstance(parts[-1], Pause):
        parts.pop()
    parts.append(Pause("sentence", PAUSES["sentence"][0]))
    asked = text.rstrip("\"'”’») ").endswith("?")
    return Sentence(" ".join(text.split()), "question" if asked else "statement", tuple(parts))


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")
