"""Text generation: sentences of the project's grammars, with pauses, fillers and restarts, which espeak lacks.

Speech without hesitations carries no sign of planning, so gaze could not depend on it. Pure: takes a random generator
and returns sentences; reads and writes no files.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log
from typing import Literal, TypeVar

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.synthesis.grammar import GRAMMARS, Grammar

SentenceKind = Literal["statement", "question", "list", "hesitation"]
PauseKind = Literal["comma", "hesitation", "sentence"]
K = TypeVar("K", bound=str)


@dataclass(frozen=True)
class Word:
    """A word as written, with the punctuation that follows it (which determines intonation)."""

    text: str


@dataclass(frozen=True)
class Filler:
    """An um or uh."""

    text: str


@dataclass(frozen=True)
class Pause:
    """A silence inside the turn."""

    kind: PauseKind
    seconds: float


SpeechUnit = Word | Filler | Pause


@dataclass(frozen=True)
class Sentence:
    """A sentence: `text` without hesitations, `parts` as spoken."""

    text: str
    kind: SentenceKind
    parts: tuple[SpeechUnit, ...]


@dataclass(frozen=True)
class Script:
    """The sentences of one speaker in one sound."""

    language: str
    sentences: tuple[Sentence, ...]

    @property
    def sentences_text(self) -> tuple[str, ...]:
        """The sentences without hesitations: sounds that have a sentence in common belong to the same split."""
        return tuple(sentence.text for sentence in self.sentences)

    @property
    def parts(self) -> tuple[SpeechUnit, ...]:
        """All spoken parts, in order."""
        return tuple(part for sentence in self.sentences for part in sentence.parts)

    @property
    def text(self) -> str:
        """All spoken text, including hesitations."""
        return " ".join(part.text for part in self.parts if not isinstance(part, Pause))


KIND_SHARES: Mapping[SentenceKind, float] = {"statement": 0.45, "question": 0.15, "list": 0.15, "hesitation": 0.25}

# Median, sigma of the logarithm, minimum and maximum, in seconds; the bounds prevent a clip of 8 s
# that consists of pauses.
PAUSES: Mapping[PauseKind, tuple[float, float, float, float]] = {
    "comma": (0.22, 0.4, 0.08, 0.8),
    "hesitation": (0.5, 0.6, 0.15, 1.8),
    "sentence": (0.5, 0.6, 0.15, 1.8),
}
HESITATIONS = {"filler": 0.35, "late filler": 0.2, "silence": 0.2, "restart": 0.25}
INITIAL_FILLER_PROBABILITY = 0.3  # fraction of hesitating sentences that begin with a filler

# Duration of text at the usual rate (170 words per minute), measured over the voices of each language.
SECONDS_PER_LETTER = 0.051
SECONDS_PER_FILLER = 0.54
CANDIDATES = 8
SHORTEST_SENTENCE_S = 1.2
MIN_NEXT_SENTENCE_S = 1.9  # duration of a short sentence
END_TOLERANCE_S = 0.2
SLOT = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class TextPartition:
    """A partition of all sentences by a hash of their text: disjoint partitions have no sentence in common."""

    start: float = 0.0
    stop: float = 1.0

    def __contains__(self, text: str) -> bool:
        return self.start <= zlib.crc32(text.encode()) / 2**32 < self.stop


ALL_TEXT = TextPartition()


def languages() -> tuple[str, ...]:
    """The languages that have a grammar."""
    return tuple(GRAMMARS)


def write_sentence(
    language: str,
    remaining_s: float,
    rng: np.random.Generator,
    partition: TextPartition = ALL_TEXT,
    pace: float = 1.0,
) -> Sentence:
    """Write a sentence that leaves time for another in `remaining_s` seconds, or else ends closest to it.

    `pace` is the duration of speech relative to the usual rate. The kind of sentence is sampled first, to preserve the
    proportions of kinds; other kinds are tried only if none of that kind fits.
    """
    grammar = grammar_of(language)
    kind = _sample_name(KIND_SHARES, rng)
    candidates: list[Sentence] = []
    for number in range(2 * CANDIDATES):
        if number >= CANDIDATES:
            kind = _sample_name(KIND_SHARES, rng)
        candidates.append(_sentence(kind, grammar, rng, partition))
        over_s = remaining_s - estimated_duration_s(candidates[-1], pace)
        if over_s > MIN_NEXT_SENTENCE_S * pace or abs(over_s) < END_TOLERANCE_S * (1 + number // CANDIDATES):
            return candidates[-1]
    return min(candidates, key=lambda each: abs(remaining_s - estimated_duration_s(without_last_pause(each), pace)))


def estimated_duration_s(sentence: Sentence, pace: float = 1.0) -> float:
    """Estimated duration of a sentence, including pauses."""
    return sum((_part_s(part, pace) for part in sentence.parts), 0.0)


def _part_s(part: SpeechUnit, pace: float) -> float:
    match part:
        case Word():
            return pace * SECONDS_PER_LETTER * (len(part.text) + 1)
        case Filler():
            return pace * SECONDS_PER_FILLER
        case Pause():
            return part.seconds


def without_last_pause(sentence: Sentence) -> Sentence:
    """The sentence without its final pause, as the last of a turn."""
    return Sentence(sentence.text, sentence.kind, sentence.parts[:-1])


def grammar_of(language: str) -> Grammar:
    """The grammar of a language. Raises InputError if it has none."""
    if language not in GRAMMARS:
        raise InputError(f"language: should be one of {', '.join(GRAMMARS)}, got {language!r}")
    return GRAMMARS[language]


def _sentence(kind: SentenceKind, grammar: Grammar, rng: np.random.Generator, partition: TextPartition) -> Sentence:
    symbol = "statement" if kind == "hesitation" else kind
    text = ""
    while not text or text not in partition:
        text = _capitalised(_expand(symbol, grammar, rng, set()))
    parts: list[SpeechUnit] = []
    for token in text.split():
        parts.append(Word(token))
        if token.endswith(","):
            parts.append(_pause("comma", rng))
    if kind == "hesitation":
        parts = _hesitate(parts, grammar["filler"], rng)
    return Sentence(text, kind, (*parts, _pause("sentence", rng)))


def _capitalised(text: str) -> str:
    """Capitalise the first letter (Spanish questions start with a mark)."""
    first = 1 if text[0] == "¿" else 0
    return text[:first] + text[first].upper() + text[first + 1 :]


def _expand(symbol: str, grammar: Grammar, rng: np.random.Generator, used: set[tuple[str, str]]) -> str:
    chosen = _one_of(grammar[symbol], rng)
    if (symbol, chosen) in used:
        chosen = _one_of([each for each in grammar[symbol] if (symbol, each) not in used] or [chosen], rng)
    used.add((symbol, chosen))
    return SLOT.sub(lambda slot: _expand(slot[1], grammar, rng, used), chosen) if "{" in chosen else chosen


def _one_of(choices: Sequence[str], rng: np.random.Generator) -> str:
    return choices[int(rng.random() * len(choices))]  # ten times faster than random.integers


def _sample_name(shares: Mapping[K, float], rng: np.random.Generator) -> K:
    """Sample a name with the given probabilities."""
    stops = np.cumsum(list(shares.values()))
    return tuple(shares)[min(int(np.searchsorted(stops, rng.random(), "right")), len(stops) - 1)]


def _pause(kind: PauseKind, rng: np.random.Generator) -> Pause:
    median_s, sigma, shortest_s, longest_s = PAUSES[kind]
    seconds = min(max(rng.lognormal(log(median_s), sigma), shortest_s), longest_s)
    return Pause(kind, round(seconds, 3))


def _hesitate(parts: list[SpeechUnit], fillers: tuple[str, ...], rng: np.random.Generator) -> list[SpeechUnit]:
    """Insert one or two hesitations between words: a filler, a silence, or a restart that repeats the last words."""
    gaps = [i for i in range(1, len(parts)) if isinstance(parts[i - 1], Word) and isinstance(parts[i], Word)]
    count = min(len(gaps), int(rng.integers(1, 3)))
    chosen: list[int] = rng.choice(gaps, size=count, replace=False).tolist()
    spoken = list(parts)
    for gap in sorted(chosen, reverse=True):
        spoken[gap:gap] = _hesitation(_sample_name(HESITATIONS, rng), spoken, gap, fillers, rng)
    if rng.random() < INITIAL_FILLER_PROBABILITY:
        spoken[:0] = [Filler(_one_of(fillers, rng)), _pause("hesitation", rng)]
    return spoken


def _hesitation(
    form: str, spoken: list[SpeechUnit], gap: int, fillers: tuple[str, ...], rng: np.random.Generator
) -> list[SpeechUnit]:
    """The parts to insert into a gap between words."""
    filler = Filler(_one_of(fillers, rng))
    silence = _pause("hesitation", rng)
    match form:
        case "filler":
            return [filler, silence]
        case "late filler":
            return [_pause("hesitation", rng), filler, silence]
        case "restart":
            return [silence, *_repeated(spoken, gap)]
        case _:
            return [silence]


def _repeated(parts: list[SpeechUnit], gap: int) -> list[SpeechUnit]:
    """The one or two words before a gap that follow each other without a pause."""
    start = gap - 1
    if start > 0 and isinstance(parts[start - 1], Word):
        start -= 1
    return parts[start:gap]
