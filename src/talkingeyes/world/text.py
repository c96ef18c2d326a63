"""What is said: sentences of the project's own grammar, with the pauses, fillers and restarts that espeak never makes.

Speech without hesitations carries no sign of planning, so gaze could not follow from it (FACTS.md, section 3, TTS
caveats). Pure: takes a generator, gives a Script; nothing is read or written.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import log, prod
from typing import Literal

import numpy as np

from talkingeyes.errors import InputError
from talkingeyes.world.grammar import GRAMMARS

SentenceKind = Literal["statement", "question", "list", "hesitation"]
PauseKind = Literal["comma", "hesitation", "sentence"]


@dataclass(frozen=True)
class Word:
    """A word as written, with the punctuation that follows it (the voice takes its melody from that)."""

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


Part = Word | Filler | Pause


@dataclass(frozen=True)
class Sentence:
    """A sentence: `text` as it was meant (without hesitations), `parts` as it is spoken."""

    text: str
    kind: SentenceKind
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Script:
    """What one speaker says in one sound."""

    language: str
    sentences: tuple[Sentence, ...]

    @property
    def sentences_text(self) -> tuple[str, ...]:
        """The sentences without hesitations: sounds that share one belong to the same split."""
        return tuple(sentence.text for sentence in self.sentences)

    @property
    def parts(self) -> tuple[Part, ...]:
        """Everything that is spoken, in order."""
        return tuple(part for sentence in self.sentences for part in sentence.parts)

    @property
    def text(self) -> str:
        """Everything as spoken, hesitations included."""
        return " ".join(part.text for part in self.parts if not isinstance(part, Pause))


KIND_SHARES: Mapping[SentenceKind, float] = {"statement": 0.45, "question": 0.15, "list": 0.15, "hesitation": 0.25}

# Median, sigma of the logarithm, shortest and longest, in seconds (FACTS.md section 3); the bounds keep
# a clip of 8 s from being all pause.
PAUSES: Mapping[PauseKind, tuple[float, float, float, float]] = {
    "comma": (0.22, 0.4, 0.08, 0.8),
    "hesitation": (0.5, 0.6, 0.15, 1.8),
    "sentence": (0.5, 0.6, 0.15, 1.8),
}

# How long text takes at a usual rate (170 words a minute), measured over the voices of voices.py.
SECONDS_PER_LETTER = 0.051
SECONDS_PER_FILLER = 0.54
CANDIDATES = 8
SHORTEST_SENTENCE_S = 1.2
SLOT = re.compile(r"\{(\w+)\}")


def languages() -> tuple[str, ...]:
    """The languages that have a grammar."""
    return tuple(GRAMMARS)


def write_script(language: str, seconds: float, random: np.random.Generator) -> Script:
    """Sentences that take about `seconds` at a usual rate, never less than one sentence."""
    grammar = grammar_of(language)
    sentences: list[Sentence] = []
    left_s = seconds
    while not sentences or left_s > SHORTEST_SENTENCE_S:
        sentences.append(_fitting(grammar, left_s, random))
        left_s -= spoken_s(sentences[-1])
    last = sentences[-1]
    sentences[-1] = Sentence(last.text, last.kind, last.parts[:-1])
    return Script(language, tuple(sentences))


def _fitting(grammar: Mapping[str, tuple[str, ...]], left_s: float, random: np.random.Generator) -> Sentence:
    """The first of a few that fits, which keeps the mix of kinds; when none does, the shortest (it ends the script)."""
    candidates: list[Sentence] = []
    while len(candidates) < CANDIDATES:
        candidates.append(_sentence(grammar, random))
        if spoken_s(candidates[-1]) <= left_s:
            return candidates[-1]
    return min(candidates, key=spoken_s)


def spoken_s(sentence: Sentence) -> float:
    """About how long a sentence takes at a usual rate, its pauses included."""
    return sum(_part_s(part) for part in sentence.parts)


def _part_s(part: Part) -> float:
    match part:
        case Word():
            return SECONDS_PER_LETTER * (len(part.text) + 1)
        case Filler():
            return SECONDS_PER_FILLER
        case Pause():
            return part.seconds


def grammar_of(language: str) -> Mapping[str, tuple[str, ...]]:
    """The grammar of a language. Raises InputError if it has none."""
    if language not in GRAMMARS:
        raise InputError(f"language should be one of {', '.join(GRAMMARS)}, got {language!r}")
    return GRAMMARS[language]


def distinct(language: str, symbol: str) -> int:
    """How many expansions a rule has (repetitions of a slot inside a sentence counted too)."""
    grammar = grammar_of(language)

    @cache
    def count(name: str) -> int:
        return sum(prod(count(slot) for slot in SLOT.findall(expansion)) for expansion in grammar[name])

    return count(symbol)


def _sentence(grammar: Mapping[str, tuple[str, ...]], random: np.random.Generator) -> Sentence:
    kinds = tuple(KIND_SHARES)
    kind = kinds[random.choice(len(kinds), p=list(KIND_SHARES.values()))]
    text = _expand("statement" if kind == "hesitation" else kind, grammar, random, set())
    text = text[0].upper() + text[1:]
    parts: list[Part] = []
    for token in text.split():
        parts.append(Word(token))
        if token.endswith(","):
            parts.append(_pause("comma", random))
    if kind == "hesitation":
        parts = _hesitate(parts, grammar["filler"], random)
    return Sentence(text, kind, (*parts, _pause("sentence", random)))


def _expand(
    symbol: str, grammar: Mapping[str, tuple[str, ...]], random: np.random.Generator, used: set[tuple[str, str]]
) -> str:
    choices = [each for each in grammar[symbol] if (symbol, each) not in used] or list(grammar[symbol])
    chosen = choices[random.integers(len(choices))]
    used.add((symbol, chosen))
    return SLOT.sub(lambda slot: _expand(slot[1], grammar, random, used), chosen)


def _pause(kind: PauseKind, random: np.random.Generator) -> Pause:
    median_s, sigma, shortest_s, longest_s = PAUSES[kind]
    seconds = float(np.clip(random.lognormal(log(median_s), sigma), shortest_s, longest_s))
    return Pause(kind, round(seconds, 3))


def _hesitate(parts: list[Part], fillers: tuple[str, ...], random: np.random.Generator) -> list[Part]:
    """One or two hesitations between words: a filler, a silence, or a restart that repeats the last words."""
    gaps = [i for i in range(1, len(parts)) if isinstance(parts[i - 1], Word) and isinstance(parts[i], Word)]
    count = min(len(gaps), int(random.integers(1, 3)))
    chosen: list[int] = random.choice(gaps, size=count, replace=False).tolist()
    spoken = list(parts)
    for gap in sorted(chosen, reverse=True):
        filler = Filler(fillers[random.integers(len(fillers))])
        form = str(random.choice(("filler", "late filler", "silence", "restart"), p=(0.35, 0.2, 0.2, 0.25)))
        forms: Mapping[str, list[Part]] = {
            "filler": [filler, _pause("hesitation", random)],
            "late filler": [_pause("hesitation", random), filler, _pause("hesitation", random)],
            "silence": [_pause("hesitation", random)],
            "restart": [_pause("hesitation", random), *_repeated(spoken, gap)],
        }
        spoken[gap:gap] = forms[form]
    if random.random() < 0.3:  # planning before the first word
        spoken[:0] = [Filler(fillers[random.integers(len(fillers))]), _pause("hesitation", random)]
    return spoken


def _repeated(parts: list[Part], gap: int) -> list[Part]:
    """The one or two words before a gap, as far back as speech is unbroken."""
    start = gap - 1
    if start > 0 and isinstance(parts[start - 1], Word):
        start -= 1
    return parts[start:gap]
