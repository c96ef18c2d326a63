"""The project's own grammars by language: what sentences can be made of. Data for text.py, nothing else."""

from collections.abc import Mapping

from talkingeyes.world.grammars.dutch import DUTCH
from talkingeyes.world.grammars.english import ENGLISH
from talkingeyes.world.grammars.french import FRENCH
from talkingeyes.world.grammars.german import GERMAN
from talkingeyes.world.grammars.italian import ITALIAN
from talkingeyes.world.grammars.portuguese import PORTUGUESE
from talkingeyes.world.grammars.rules import Grammar
from talkingeyes.world.grammars.spanish import SPANISH

GRAMMARS: Mapping[str, Grammar] = {
    "en": ENGLISH,
    "fr": FRENCH,
    "de": GERMAN,
    "es": SPANISH,
    "it": ITALIAN,
    "pt": PORTUGUESE,
    "nl": DUTCH,
}
