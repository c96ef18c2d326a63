"""Synthetic text: variety, pauses and hesitations of the grammar."""

import re
from functools import cache
from itertools import pairwise
from math import prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_scripts import write_script

from talkingeyes.core.errors import InputError
from talkingeyes.synthesis.text import (
    GRAMMARS,
    PAUSES,
    SLOT,
    Filler,
    Pause,
    Script,
    Word,
    estimated_duration_s,
    languages,
)


@cache
def scripts(count: int, language: str = "en", seconds: float = 8.0) -> list[Script]:
    return [write_script(language, seconds, np.random.default_rng([3, i])) for i in range(count)]


@pytest.mark.parametrize("language", languages())
def test_every_slot_has_a_rule_and_every_rule_is_used(language: str) -> None:
    grammar = GRAMMARS[language]
    slots = {slot for expansions in grammar.values() for text in expansions for slot in SLOT.findall(text)}
    assert slots | {"statement", "question", "list", "filler"} == set(grammar)


def count_expansions(language: str, symbol: str) -> int:
    """Number of expansions of a rule, including those that repeat a slot value."""
    grammar = GRAMMARS[language]

    @cache
    def count(name: str) -> int:
        return sum(prod(count(slot) for slot in SLOT.findall(expansion)) for expansion in grammar[name])

    return count(symbol)


@pytest.mark.parametrize("language", languages())
def test_grammar_has_more_than_100_000_sentences_of_each_kind(language: str) -> None:
    assert min(count_expansions(language, kind) for kind in ("statement", "question", "list")) > 100_000


def test_sentences_rarely_repeat() -> None:
    texts = [text for script in scripts(150) for text in script.sentences_text]
    assert len(texts) >= 300
    assert len(set(texts)) >= 0.97 * len(texts)  # the shortest ones repeat, within a split


def test_all_kinds_occur_and_hesitations_are_only_in_theirs() -> None:
    sentences = [sentence for script in scripts(150) for sentence in script.sentences]
    assert {sentence.kind for sentence in sentences} == {"statement", "question", "list", "hesitation"}
    for sentence in sentences:
        hesitates = any(
            isinstance(part, Filler) or (isinstance(part, Pause) and part.kind == "hesitation")
            for part in sentence.parts
        )
        assert hesitates == (sentence.kind == "hesitation")
        assert (sentence.kind == "question") == sentence.text.endswith("?")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(languages()), st.floats(1, 20))
def test_a_script_is_well_formed(seed: int, language: str, seconds: float) -> None:
    script = write_script(language, seconds, np.random.default_rng(seed))
    assert script == write_script(language, seconds, np.random.default_rng(seed))
    parts = script.parts
    assert not isinstance(parts[0], Pause) and not isinstance(parts[-1], Pause)
    assert not any(isinstance(a, Pause) and isinstance(b, Pause) for a, b in pairwise(parts))
    for sentence in script.sentences:
        assert re.fullmatch(r"¿?[A-ZÉ][^{}]*[.?]", sentence.text)
        said = [part.text for part in sentence.parts if isinstance(part, Word)]
        assert set(said) == set(sentence.text.split())
        assert len(said) == len(sentence.text.split()) or sentence.kind == "hesitation"
    for part in parts:
        if isinstance(part, Pause):
            assert PAUSES[part.kind][2] <= part.seconds <= PAUSES[part.kind][3]


def test_sentence_pauses_have_the_reference_distribution() -> None:
    pauses = [
        p.seconds for s in scripts(150, seconds=20.0) for p in s.parts if isinstance(p, Pause) and p.kind == "sentence"
    ]
    logs = np.log(pauses)
    assert np.exp(np.median(logs)) == pytest.approx(0.5, rel=0.12)
    assert 0.45 < logs.std() < 0.65  # sigma 0.6, truncated at the bounds


def test_scripts_last_about_as_long_as_asked() -> None:
    lengths = [sum(map(estimated_duration_s, script.sentences)) for script in scripts(150)]
    assert 6.5 < np.mean(lengths) < 9.5


def test_unknown_language_is_named() -> None:
    with pytest.raises(InputError, match="one of en, fr, de, es, it, pt, nl, got 'xx'"):
        write_script("xx", 8.0, np.random.default_rng(0))
