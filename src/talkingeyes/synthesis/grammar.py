"""Sentence grammars by language, as data for text.py: `grammars/en.txt` and others.

Notation: one rule per paragraph, `name: expansion | expansion`; `{slot}` refers to another rule. A rule continues on
lines that are indented further. A slot does not take the same expansion twice in a sentence, if it has others left.
Every grammar has the rules statement, question, list and filler.
"""

import re
from collections.abc import Mapping
from pathlib import Path

Grammar = Mapping[str, tuple[str, ...]]

FOLDER = Path(__file__).parent / "grammars"


def rules(text: str) -> Grammar:
    """Parse the rules of a text: name to expansions."""
    found: dict[str, tuple[str, ...]] = {}
    for paragraph in re.split(r"\n(?=\S)", text.strip()):
        name, _, expansions = paragraph.partition(":")
        found[name] = tuple(" ".join(each.split()) for each in expansions.strip().strip("|").split("|"))
    return found


GRAMMARS: Mapping[str, Grammar] = {
    code: rules((FOLDER / f"{code}.txt").read_text("utf-8")) for code in ("en", "fr", "de", "es", "it", "pt", "nl")
}
