"""How a grammar is written down: a rule a paragraph, `name: expansion | expansion`, `{slot}` names another rule.

A rule goes on over lines that are indented further. No slot takes the same expansion twice in a sentence. Every grammar
has the rules statement, question, list and filler.
"""

import re
from collections.abc import Mapping
from textwrap import dedent

Grammar = Mapping[str, tuple[str, ...]]


def rules(text: str) -> Grammar:
    """The rules of a text: name to expansions."""
    found: dict[str, tuple[str, ...]] = {}
    for paragraph in re.split(r"\n(?=\S)", dedent(text).strip()):
        name, _, expansions = paragraph.partition(":")
        found[name] = tuple(" ".join(each.split()) for each in expansions.strip().strip("|").split("|"))
    return found
