"""What is known about a sound in time: words, phonemes, speaking and listening spans."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from talkingeyes.errors import InputError


@dataclass(frozen=True)
class Span:
    """A stretch of time in seconds with a label (a word, a phoneme, a reason; may be empty)."""

    start_s: float
    end_s: float
    label: str = ""


@dataclass(frozen=True)
class Phoneme:
    """A phoneme (espeak-ng mnemonic) in time; `stressed` marks the vowel of a stressed syllable."""

    start_s: float
    end_s: float
    symbol: str
    stressed: bool = False


@dataclass(frozen=True)
class Annotation:
    """Words, phonemes, and the spans in which the subject speaks or listens. A gap inside `speaking` is a pause.

    `pauses` are silences inside a turn (label: "comma", "hesitation" or "sentence"), `fillers` the ums and uhs.
    """

    words: tuple[Span, ...] = ()
    phonemes: tuple[Phoneme, ...] = ()
    speaking: tuple[Span, ...] = ()
    listening: tuple[Span, ...] = ()
    pauses: tuple[Span, ...] = ()
    fillers: tuple[Span, ...] = ()

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self)))

    @classmethod
    def load(cls, path: Path) -> Annotation:
        """Read JSON written by `save`. Raises InputError if it is not an annotation."""
        try:
            content = json.loads(path.read_text())
            spans = [name for name in cls.__dataclass_fields__ if name != "phonemes"]
            return cls(
                phonemes=tuple(Phoneme(**row) for row in content["phonemes"]),
                **{name: tuple(Span(**row) for row in content[name]) for name in spans},
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not a readable annotation ({error!r})") from None
