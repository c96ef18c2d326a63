"""What is said: sentences of the project's own small grammar, with the pauses, fillers and restarts that espeak never makes.

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


# A rule is a list of expansions, {slot} names another rule. No slot takes the same expansion twice in a sentence.
ENGLISH: Mapping[str, tuple[str, ...]] = {
    "statement": (
        "{who} {did} {thing} {where}.",
        "{when}, {who} {did} {thing} {where}.",
        "{who} {did} {thing}, but {who} {was} {feeling}.",
        "{view} {who} {did} {thing} {when}.",
        "if the {weather} lasts, {who} will {do} {thing} {where}.",
        "{who} {was} {feeling} {when}, so nobody {did} {thing}.",
    ),
    "question": (
        "did {who} {do} {thing} {where}?",
        "why would {who} {do} {thing} {when}?",
        "when you were {where}, did {who} {do} {thing}?",
        "who {did} {thing} {where} {when}?",
        "do you think that {who} {was} {feeling} {when}?",
    ),
    "list": (
        "{who} packed {item}, {item}, {item} and {item}.",
        "on the table {where} were {item}, {item} and {item}.",
        "first we {did} {thing}, then {who} {did} {thing}, and at last there was only {item}.",
        "you will need {item}, {item}, {item}, and perhaps {item}.",
    ),
    "who": (
        "the {kind} {person}",
        "my {person}",
        "that {kind} {person}",
        "the {person} from the {place}",
        "our neighbour",
        "the two brothers",
        "most of the children",
    ),
    "kind": ("old", "young", "quiet", "cheerful", "clever", "tired", "famous", "careful", "lazy", "friendly", "tall", "shy"),
    "person": (
        "gardener", "teacher", "pilot", "baker", "doctor", "painter", "sailor", "farmer", "singer", "cousin", "driver",
        "carpenter", "librarian", "nurse", "goldsmith", "grandmother", "fisherman", "tailor",
    ),
    "did": (
        "found", "lost", "painted", "mended", "carried", "forgot", "sold", "noticed", "borrowed", "cleaned", "hid",
        "described", "measured", "opened",
    ),
    "do": (
        "find", "lose", "paint", "mend", "carry", "forget", "sell", "notice", "borrow", "clean", "hide", "describe",
        "measure", "open",
    ),
    "thing": (
        "the {look} {object}", "this {look} {object}", "another {object}", "every {object}", "both of the boats",
        "the last {object}", "some of the letters",
    ),
    "look": ("wooden", "yellow", "broken", "heavy", "silver", "empty", "narrow", "dusty", "green", "strange", "tiny", "round"),
    "object": (
        "window", "bicycle", "basket", "piano", "lantern", "suitcase", "mirror", "ladder", "kettle", "umbrella", "drum",
        "chair", "bottle", "carpet", "compass", "wardrobe",
    ),
    "where": (
        "in the {place}", "behind the {place}", "near the {place}", "on the way to the {place}", "outside the {place}",
    ),
    "place": (
        "harbour", "village", "kitchen", "station", "market", "museum", "forest", "library", "valley", "garden", "bakery",
        "school", "theatre", "mountain", "lighthouse",
    ),
    "when": (
        "yesterday", "last summer", "before breakfast", "on Monday morning", "after the storm", "a week ago", "at midnight",
        "during the holidays", "a long time ago", "just before the meeting", "in the winter", "this afternoon",
    ),
    "was": ("seemed", "looked", "felt", "stayed"),
    "feeling": (
        "happy", "surprised", "very hungry", "a little worried", "rather proud", "completely lost", "quite calm", "angry",
        "not at all ready", "half asleep", "terribly bored", "grateful",
    ),
    "view": (
        "I believe that", "everybody knows that", "somebody told me that", "it is true that", "we were glad that",
        "nobody remembers that", "the newspaper said that", "I was surprised that",
    ),
    "weather": ("rain", "sunshine", "wind", "snow", "fog", "heat"),
    "item": (
        "bread", "apples", "a map", "two candles", "warm socks", "honey", "a bottle of water", "some string", "cheese",
        "a torch", "three pencils", "a woollen blanket", "matches", "coffee", "an old newspaper", "onions", "a pocket knife",
        "soap",
    ),
    "filler": ("um", "uh", "er", "um"),
}  # fmt: skip

FRENCH: Mapping[str, tuple[str, ...]] = {
    "statement": (
        "{who} a {did} {thing} {where}.",
        "{when}, {who} a {did} {thing} {where}.",
        "{view} {who} a {did} {thing} {when}.",
        "{who} a {did} {thing}, mais personne ne regardait.",
    ),
    "question": ("est-ce que {who} a {did} {thing} {where}?", "pourquoi {who} a {did} {thing} {when}?"),
    "list": (
        "{who} a pris {item}, {item}, {item} et {item}.",
        "sur la table, il y avait {item}, {item} et {item}.",
    ),
    "who": (
        "le {person}", "ce pauvre {person}", "notre {person}", "mon ami le {person}", "le jeune {person}",
        "un {person} du village",
    ),
    "person": ("boulanger", "facteur", "pilote", "voisin", "peintre", "marin", "jardinier", "docteur", "tailleur", "chanteur"),
    "did": ("vendu", "perdu", "trouvé", "réparé", "oublié", "caché", "nettoyé", "porté", "mesuré", "décrit"),
    "thing": ("le petit {object}", "un vieux {object}", "son {object}", "le dernier {object}", "ce grand {object}"),
    "object": ("panier", "tambour", "miroir", "piano", "bateau", "tapis", "vélo", "fauteuil", "parapluie", "couteau"),
    "where": ("dans le {place}", "près du {place}", "derrière le {place}", "devant le {place}"),
    "place": ("port", "village", "jardin", "marché", "musée", "théâtre", "bois", "moulin"),
    "when": ("hier soir", "ce matin", "après la pluie", "avant le dîner", "lundi dernier", "pendant les vacances", "en hiver"),
    "view": ("je crois que", "tout le monde sait que", "on m'a dit que", "il est vrai que"),
    "item": (
        "du pain", "des pommes", "une carte", "deux bougies", "du fromage", "une lampe", "du miel", "trois crayons",
        "une couverture", "du savon", "du café", "des oignons",
    ),
    "filler": ("euh", "euh"),
}  # fmt: skip

GRAMMARS: Mapping[str, Mapping[str, tuple[str, ...]]] = {"en": ENGLISH, "fr": FRENCH}
KIND_SHARES: Mapping[SentenceKind, float] = {"statement": 0.45, "question": 0.15, "list": 0.15, "hesitation": 0.25}

# Median, sigma of the logarithm, shortest and longest, in seconds (FACTS.md section 3; the clips keep 8 s from being all pause).
PAUSES: Mapping[PauseKind, tuple[float, float, float, float]] = {
    "comma": (0.22, 0.4, 0.08, 0.8),
    "hesitation": (0.5, 0.6, 0.15, 1.8),
    "sentence": (0.5, 0.6, 0.15, 1.8),
}

# How long text takes at a usual rate (170 words a minute), measured over the voices of voices.py.
SECONDS_PER_LETTER = 0.062
SECONDS_PER_FILLER = 0.35
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
        candidates = [_sentence(grammar, random) for _ in range(CANDIDATES)]
        fitting = [each for each in candidates if spoken_s(each) <= left_s]
        # The first that fits keeps the mix of kinds; when none does, the shortest ends the script.
        sentences.append(fitting[0] if fitting else min(candidates, key=spoken_s))
        left_s -= spoken_s(sentences[-1])
    last = sentences[-1]
    sentences[-1] = Sentence(last.text, last.kind, last.parts[:-1])
    return Script(language, tuple(sentences))


def spoken_s(sentence: Sentence) -> float:
    """About how long a sentence takes at a usual rate, its pauses included."""
    lengths = {
        Word: lambda part: SECONDS_PER_LETTER * (len(part.text) + 1),
        Filler: lambda part: SECONDS_PER_FILLER,
        Pause: lambda part: part.seconds,
    }
    return sum(lengths[type(part)](part) for part in sentence.parts)


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
    chosen = sorted(random.choice(gaps, size=min(len(gaps), int(random.integers(1, 3))), replace=False), reverse=True)
    spoken = list(parts)
    for gap in chosen:
        filler = Filler(fillers[random.integers(len(fillers))])
        form = random.choice(("filler", "late filler", "silence", "restart"), p=(0.35, 0.2, 0.2, 0.25))
        inserted: list[Part] = {
            "filler": [filler, _pause("hesitation", random)],
            "late filler": [_pause("hesitation", random), filler, _pause("hesitation", random)],
            "silence": [_pause("hesitation", random)],
            "restart": [_pause("hesitation", random), *_repeated(spoken, gap)],
        }[str(form)]
        spoken[gap:gap] = inserted
    if random.random() < 0.3:  # planning before the first word
        spoken[:0] = [Filler(fillers[random.integers(len(fillers))]), _pause("hesitation", random)]
    return spoken


def _repeated(parts: list[Part], gap: int) -> list[Part]:
    """The one or two words before a gap, as far back as speech is unbroken."""
    start = gap - 1
    if start > 0 and isinstance(parts[start - 1], Word):
        start -= 1
    return parts[start:gap]
