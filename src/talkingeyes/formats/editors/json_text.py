"""Edits JSON of coefficients (readers/json_layouts.py): only the numbers of eyes and head change, all else stays.

The parser reports numbers in the order of the text, so each number in the parsed content knows its place in the text.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.containers import MAX_TEXT_BYTES, read_bytes, reading
from talkingeyes.core.errors import InputError
from talkingeyes.formats.csv_text import encoding_of
from talkingeyes.formats.editors.channels import EYE_NAMES, AddedEyes, channel_names, eye_channels
from talkingeyes.formats.readers.arkit_json import json_timing
from talkingeyes.formats.readers.json_layouts import coefficient_rows, parse_documents, read_documents
from talkingeyes.formats.writers.arkit import DIGITS

# A text, to be passed over, or a number.
TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|(-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)', re.DOTALL)


class PlacedNumber(float):
    """A number of a JSON text, with its index among the numbers of the text."""

    place: int


@dataclass(frozen=True)
class JsonFile:
    """A JSON text, its content with placed numbers, and where each number stands in the text."""

    path: Path
    text: str
    content: Any
    spans: list[tuple[int, int]] = field(repr=False)
    frames: Int[ndarray, " R"]  # of the rows
    encoding: str

    @property
    def has_head(self) -> bool:
        return isinstance(self.content, dict) and "head" in self.content

    def edited(self, added: AddedEyes) -> bytes:
        """The file with eyes and head."""
        found = coefficient_rows(self.path, self.content)
        names = channel_names(found.names)
        wanted, new = eye_channels(added.motion, names), dict[int, float]()
        for column, name in enumerate(names):
            if name in wanted:
                numbers = [row[column] for row in found.rows]
                own = np.array(numbers, float)  # None, where a face is lost, becomes NaN
                new |= self._placed(numbers, added.mixed(own, wanted[name][self.frames]))
        turned = {"eyes": added.motion.gaze.reshape(-1, 3)}
        turned |= {"head": added.motion.head} if added.with_head else {}
        for name, rotations in turned.items():
            if isinstance(self.content, dict) and name in self.content:
                numbers = list(_numbers(self.content[name]))
                mixed = added.mixed_turns(np.array(numbers, float).reshape(rotations.shape), rotations)
                new |= self._placed(numbers, mixed.ravel())
        parts, last = [], 0
        for place in sorted(new) if added.share > 0 else ():
            start, stop = self.spans[place]
            parts += [self.text[last:start], json.dumps(round(new[place], DIGITS))]
            last = stop
        return "".join([*parts, self.text[last:]]).encode(self.encoding)

    def _placed(self, numbers: Sequence[Any], values: Float[ndarray, " N"]) -> dict[int, float]:
        if not all(isinstance(number, PlacedNumber) for number in numbers if number is not None):
            raise InputError(f"{self.path}: rows should be numbers of the JSON itself, one for each name")
        placed = zip(numbers, values.tolist(), strict=True)
        return {number.place: value for number, value in placed if number is not None}


def open_json(path: Path, fps: float | None) -> JsonFile:
    """Open a JSON. Raises InputError (one line) if it is not one of the layouts."""
    with reading(path, "JSON with fps, names and coefficients"):
        read_documents(path)  # checks the depth
        data = read_bytes(path, MAX_TEXT_BYTES)
        encoding = encoding_of(data)
        text = data.decode(encoding)
        count = -1

        def placed(digits: str) -> PlacedNumber:
            nonlocal count
            number, count = PlacedNumber(digits), count + 1
            number.place = count
            return number

        decoder = json.JSONDecoder(parse_float=placed, parse_int=placed, parse_constant=_refused)
        content = parse_documents(text, decoder)
        spans = [match.span(1) for match in TOKEN.finditer(text) if match[1] is not None]
    found = coefficient_rows(path, content)
    if EYE_NAMES.isdisjoint(channel_names(found.names)):
        raise InputError(
            f"{path}: should have coefficients of eyes (eyeBlinkLeft, ...), got {', '.join(found.names[:5])}"
        )
    return JsonFile(path, text, content, spans, json_timing(path, found, fps).frames, encoding)


def _numbers(value: Any) -> Iterator[Any]:
    """The numbers in nested lists, in order."""
    if isinstance(value, list):
        for each in value:
            yield from _numbers(each)
    else:
        yield value


def _refused(constant: str) -> float:
    raise ValueError(f"numbers should be finite, got {constant}")
