"""Time-aligned annotation of a sound: words, phonemes, speaking and listening spans, emotion."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.settings import validate_record

# The classes of 3DMEAD (ProbTalk3D, section 3.1); neutral has intensity 0, the others 1 (weak) to 3 (strong).
EMOTIONS = ("neutral", "happy", "sad", "surprised", "fear", "disgusted", "angry", "contempt")
INTENSITIES = (1, 2, 3)


@dataclass(frozen=True)
class Span:
    """A time interval in seconds with a label (a word, a phoneme, a reason; may be empty)."""

    start_s: float
    end_s: float
    label: str = ""


@dataclass(frozen=True)
class Phoneme:
    """A phoneme (espeak-ng mnemonic) in time; `stressed` marks the vowel of a stressed syllable.

    `prominence`, 0 to 1, is that of the stressed syllable in its phrase; 0 for all other phonemes. `loudness` is the
    level relative to the median stressed vowel of the sound (1 if unknown).
    """

    start_s: float
    end_s: float
    symbol: str
    stressed: bool = False
    prominence: float = 0.0
    loudness: float = 1.0


@dataclass(frozen=True)
class Annotation:
    """Words, phonemes, and the spans in which the subject speaks or listens. A gap inside `speaking` is a pause.

    `pauses` are silences inside a turn (label: "comma", "hesitation" or "sentence"), `fillers` the ums and uhs,
    `sentences` have their kind as label ("statement", "question", "list" or "hesitation"). In `listening` spans the
    partner has the turn; in `partner` spans the partner's voice sounds. `intensity` is 0 for neutral, else 1 to 3.
    """

    words: tuple[Span, ...] = ()
    phonemes: tuple[Phoneme, ...] = ()
    speaking: tuple[Span, ...] = ()
    listening: tuple[Span, ...] = ()
    pauses: tuple[Span, ...] = ()
    fillers: tuple[Span, ...] = ()
    sentences: tuple[Span, ...] = ()
    partner: tuple[Span, ...] = ()
    emotion: str = "neutral"
    intensity: int = 0

    def shifted(self, by_s: float) -> Annotation:
        """The same events, later by `by_s` seconds."""
        return self._with_spans(lambda span: replace(span, start_s=span.start_s + by_s, end_s=span.end_s + by_s))

    def clipped(self, seconds: float) -> Annotation:
        """The parts of all events between 0 and `seconds`."""

        def inside(span: Any) -> Any | None:
            start_s, end_s = max(span.start_s, 0.0), min(span.end_s, seconds)
            return replace(span, start_s=start_s, end_s=end_s) if end_s > start_s else None

        return self._with_spans(inside)

    def _with_spans(self, change: Callable[[Any], Any | None]) -> Annotation:
        """The annotation with every span and phoneme changed; those that become None are left out."""
        changed: dict[str, Any] = {}
        for name, value in vars(self).items():
            if isinstance(value, tuple):
                changed[name] = tuple(each for each in map(change, value) if each is not None)
        return replace(self, **changed)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(vars(self), default=vars))  # asdict would copy every number

    @classmethod
    def load(cls, path: Path) -> Annotation:
        """Read JSON written by `save`; an absent key stays empty. Raises InputError if it is not an annotation."""
        content = read_json(path, "annotation")
        with reading(path, "annotation"):
            found = validate_record(cls, content)
            if not all(math.isfinite(span.start_s) and math.isfinite(span.end_s) for span in _spans(found)):
                raise ValueError("times should be finite")
        return found


def _spans(annotation: Annotation) -> Iterator[Span | Phoneme]:
    return (span for value in vars(annotation).values() if isinstance(value, tuple) for span in value)
