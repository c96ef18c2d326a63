"""Sentence grammars by language, as data for text.py."""

from collections.abc import Mapping

from talkingeyes.synthesis.grammars.dutch import DUTCH
from talkingeyes.synthesis.grammars.english import ENGLISH
from talkingeyes.synthesis.grammars.french import FRENCH
from talkingeyes.synthesis.grammars.german import GERMAN
from talkingeyes.synthesis.grammars.italian import ITALIAN
from talkingeyes.synthesis.grammars.portuguese import PORTUGUESE
from talkingeyes.synthesis.grammars.rules import Grammar
from talkingeyes.synthesis.grammars.spanish import SPANISH

GRAMMARS: Mapping[str, Grammar] = {
    "en": ENGLISH,
    "fr": FRENCH,
    "de": GERMAN,
    "es": SPANISH,
    "it": ITALIAN,
    "pt": PORTUGUESE,
    "nl": DUTCH,
}
