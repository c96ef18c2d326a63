"""Where the coefficients are in a JSON: the layouts of programs, found by what they hold.

    names: [...], coefficients: [[...], ...]      a list of names and a row of numbers a frame, whatever the keys: ours,
                                                  Audio2Face (facsNames, weightMat), LAM (names, frames[].weights)
    FrameIndex, BlendShapes: [[...], ...]         Azure's visemes: ARKit's order, then three rolls; one object, or many
    [{faceBlendshapes: [{categories: ...}]}, ...] MediaPipe's results: a list of categories, or of names, a frame
    vs: {eyeBlinkLeft: [...], ...}, dt: [...]     TalkingHead's animation: a list of numbers a shape

Numbers are those of the parsed content, so that an editor knows where they stand; None where a frame has no number.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from talkingeyes.core.containers import MAX_TEXT_BYTES, parse_json, read_bytes, reading
from talkingeyes.core.errors import InputError
from talkingeyes.formats import arkit
from talkingeyes.formats.csv_text import MARK, encoding_of
from talkingeyes.formats.shape_names import STANDARD_NAMES, shape_names

LETTER = re.compile(rf"[^\s{MARK}]")
MAX_FRAMES = 1_000_000
MAX_STEP_RATIO = 1.5  # of the longest to the shortest step of keys that are frames
AZURE_FPS = 60.0
AZURE_NAMES = (*arkit.NAMES, "headRoll", "leftEyeRoll", "rightEyeRoll")
RATE_KEYS = ("fps", "exportfps", "framerate")
TIME_KEYS = ("timestamp", "timestampms", "timestamps", "time", "timems", "timecode", "t")
SHAPE_KEYS = ("faceblendshapes", "blendshapes", "categories", "weights", "coefficients", "shapes", "scores", "vs")
NAME_KEYS, SCORE_KEYS = ("categoryname", "name", "label"), ("score", "value", "weight")
MATRIX_KEYS = ("facialtransformationmatrixes", "facialtransformationmatrices", "transformationmatrix")


@dataclass(frozen=True)
class CoefficientRows:
    """Names as written, a row of numbers a frame, the frame rate if stated, else the times; turns of the head."""

    names: tuple[str, ...]
    rows: Sequence[Sequence[Any]]
    fps: float | None
    times: tuple[str, ...] = ()
    matrices: tuple[Any, ...] = ()  # of the head, in a frame each

    @property
    def shapes(self) -> tuple[str, ...]:
        """The names as ARKit spells them."""
        return shape_names(self.names)


def read_documents(path: Path) -> Any:
    """The value of a JSON file, or the list of its values, as of lines. Raises InputError (one line)."""
    with reading(path, "JSON with fps, names and coefficients"):
        data = read_bytes(path, MAX_TEXT_BYTES)
        text = data.decode(encoding_of(data)).lstrip(MARK)
        try:
            return parse_json(text)
        except json.JSONDecodeError as error:
            if not error.msg.startswith("Extra data"):
                raise
        return [parse_json(text[start:stop]) for _, start, stop in _documents(text, json.JSONDecoder())]


def parse_documents(text: str, decoder: json.JSONDecoder) -> Any:
    """The value of a text that `read_documents` has read, by a decoder, or the list of its values."""
    values = [value for value, _, _ in _documents(text, decoder)]
    return values[0] if len(values) == 1 else values


def _documents(text: str, decoder: json.JSONDecoder) -> Iterator[tuple[Any, int, int]]:
    """The values in a text, each with its start and its end."""
    end = 0
    while (start := len(text) if (found := LETTER.search(text, end)) is None else found.start()) < len(text):
        value, end = decoder.raw_decode(text, start)
        yield value, start, end


def coefficient_rows(path: Path, content: Any) -> CoefficientRows:
    """Find the coefficients in a parsed JSON. Raises InputError (one line) for another layout."""
    layouts: tuple[Callable[[Any], CoefficientRows | None], ...] = (_azure, _named_rows, _columns, _frames)
    try:
        found = next((found for layout in layouts if (found := layout(content)) is not None), None)
    except (AttributeError, ValueError, KeyError, TypeError, IndexError) as error:
        said = str(error) if isinstance(error, InputError) else repr(error)
        raise InputError(f"{path}: should be JSON with fps, names and coefficients ({said})") from None
    if found is None:
        keys = ", ".join(map(str, content)) if isinstance(content, dict) else f"a {type(content).__name__}"
        raise InputError(f"{path}: should be JSON with fps, names and coefficients, or frames of them, got {keys}")
    return found


def _azure(content: Any) -> CoefficientRows | None:
    """Chunks of visemes, each with the index of its first frame; maybe inside of events, as texts, or under a key."""
    lists = content.values() if isinstance(content, dict) else ()
    events = next((each for each in (content, *lists) if isinstance(each, list)), ())
    chunks = [_chunk(each) for each in (content, *events)]
    known = sorted((chunk for chunk in chunks if chunk is not None), key=lambda chunk: float(chunk["frameindex"]))
    rows: list[Sequence[Any]] = []
    for chunk in known:
        first = int(chunk["frameindex"]) - int(known[0]["frameindex"])
        if first > MAX_FRAMES:
            raise InputError(f"FrameIndex should be at most {MAX_FRAMES:,}, got {first:,}")
        rows += [[None] * len(AZURE_NAMES)] * (first - len(rows))
        rows[first:] = chunk["blendshapes"]
    return CoefficientRows(AZURE_NAMES, rows, AZURE_FPS) if known else None


def _chunk(content: Any) -> dict[str, Any] | None:
    while isinstance(content, dict):
        by_key = {_key(name): value for name, value in content.items()}
        if "frameindex" in by_key and "blendshapes" in by_key:
            return by_key
        content = by_key.get("animation")
        content = parse_json(content) if isinstance(content, str) and content.startswith("{") else content
    return None


def _named_rows(content: Any) -> CoefficientRows | None:
    """A list of names beside rows of as many numbers."""
    if not isinstance(content, dict):
        return None
    lists = [value for value in content.values() if isinstance(value, list) and value]
    for names in (each for each in lists if all(isinstance(name, str) for name in each)):
        for each in lists:
            rows = [row if not isinstance(row, dict) else _widest(row.values()) for row in each]
            if len(next((row for row in rows if isinstance(row, list)), ())) == len(names):
                nothing = [None] * len(names)
                return CoefficientRows(tuple(names), [row or nothing for row in rows], _rate(content))
    return None


def _widest(values: Iterable[Any]) -> Any:
    return max((value for value in values if isinstance(value, list)), key=len, default=None)


def _columns(content: Any) -> CoefficientRows | None:
    """A list of numbers a shape, at the top or under a key of shapes."""
    if not isinstance(content, dict):
        return None
    for place in (content, content.get("anim"), *(content[key] for key in content if _key(key) in SHAPE_KEYS)):
        columns = {} if not isinstance(place, dict) else {k: v for k, v in place.items() if isinstance(v, list)}
        if _knows(columns):
            named = {name: column for name, column in columns.items() if _key(name) not in ("dt", "ts", "vt", "vs")}
            length = max(map(len, named.values()))
            rows = list(zip(*(named[name] for name in named if len(named[name]) == length), strict=True))
            return CoefficientRows(tuple(named), rows, _rate(content), _key_times(content, length))
        if isinstance(place, dict) and place is not content and "vs" in place:
            return _columns(place)
    return None


def _key_times(content: dict[str, Any], length: int) -> tuple[str, ...]:
    """The times of TalkingHead's keys in ms: `vt` or `ts`, or the sums of the steps `dt`."""
    times = next((content[key] for key in ("vt", "ts", "times") if isinstance(content.get(key), list)), None)
    if times is None and isinstance(content.get("dt"), list):
        steps = [float(step) for step in content["dt"]]
        if max(steps) > MAX_STEP_RATIO * min(steps):
            raise InputError(f"TalkingHead's dt should be even, a key a frame, got {min(steps):g} to {max(steps):g} ms")
        times = list(accumulate(steps, initial=0.0))
    return () if times is None else tuple(f"{float(time):.3f}" for time in times[:length])


def _frames(content: Any) -> CoefficientRows | None:
    """A list of frames, each with the names of its shapes."""
    places = [content] if isinstance(content, list) else content.values() if isinstance(content, dict) else ()
    for frames in (place for place in places if isinstance(place, list)):
        found = [_shapes(frame) for frame in frames]
        if any(_knows(each) for each in found if each):
            names = tuple(dict.fromkeys(name for each in found if each for name in each))
            rows = [[(each or {}).get(name) for name in names] for each in found]
            times = [_inside(frame, TIME_KEYS) for frame in frames]
            rate = _rate(content) if isinstance(content, dict) else None
            known = tuple(map(str, times)) if None not in times else ()
            matrices = tuple(_inside(frame, MATRIX_KEYS) for frame in frames)
            return CoefficientRows(names, rows, rate, known, matrices if any(matrices) else ())
    return None


def _shapes(frame: Any) -> dict[str, Any] | None:
    """The numbers of a frame by name; none (or None) where it has no face."""
    if not isinstance(frame, dict):
        return None
    for key, value in frame.items():
        if _key(key) in SHAPE_KEYS:
            return _by_name(value)
    numbers = {name: each for name, each in frame.items() if isinstance(each, int | float) and each is not bool(each)}
    if _knows(numbers):
        return {name: value for name, value in numbers.items() if _key(name) not in TIME_KEYS}
    inner = (value[0] if isinstance(value, list) and value else value for value in frame.values())
    return next((found for value in inner if (found := _shapes(value)) is not None), None)


def _by_name(value: Any) -> dict[str, Any]:
    """Numbers by name: a dictionary, a list of categories, or the first of the faces."""
    if isinstance(value, dict):
        inner = next((value[key] for key in value if _key(key) in SHAPE_KEYS), None)
        return value if inner is None else _by_name(inner)
    if not isinstance(value, list) or not value:
        return {}
    if all(isinstance(each, dict) and _value(each, NAME_KEYS) is not None for each in value):
        return {str(_value(each, NAME_KEYS)): _value(each, SCORE_KEYS) for each in value}
    return _by_name(value[0])


def _knows(names: Iterable[str]) -> bool:
    return not set(STANDARD_NAMES).isdisjoint(shape_names(list(map(str, names))))


def _rate(content: dict[str, Any]) -> float | None:
    """The frame rate that is stated, beside the rows or in an object such as `metadata`."""
    for place in (content, *(value for value in content.values() if isinstance(value, dict))):
        rate = _value(place, RATE_KEYS)
        if rate is not None:
            return float(rate)
    return None


def _value(place: Any, keys: Sequence[str]) -> Any:
    return next((value for key, value in place.items() if _key(key) in keys), None) if isinstance(place, dict) else None


def _inside(frame: Any, keys: Sequence[str]) -> Any:
    """The value of a key of a frame, or of an object in it."""
    inner = frame.values() if isinstance(frame, dict) else ()
    return next((found for each in (frame, *inner) if (found := _value(each, keys)) is not None), None)


def _key(name: str) -> str:
    """A key in small letters, without separators."""
    return "".join(filter(str.isalpha, name.lower()))
