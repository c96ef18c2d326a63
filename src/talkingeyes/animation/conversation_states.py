"""States of a conversation: speaking, listening, thinking, idle; from a track (.csv, .json) or from sound.

The learnt model covers speaking, and its own silence; what a state adds is rule-based (`animation/steps/states.py`).
Time that a track does not list gets the state that the sounds show.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.containers import parse_json, read_text
from talkingeyes.core.errors import InputError

State = Literal["speaking", "listening", "thinking", "idle"]
STATES: tuple[State, ...] = get_args(State)
AUTO = "auto"
SCHEMA = "talkingeyes.states/1"
COLUMNS = ("start_s", "end_s", "state")
MIN_STATE_S = 0.25
# From sound: silences of this length before the own speech, or within the own turn, are thinking; the limits are those
# of `synthesis/gaze_aversion.py` (utterances after pauses of 0.5 s are planned) and of people.md (2 s end a turn).
THINKING_S, IDLE_S = 0.5, 2.0
PLANNING_S = 1.3  # thinking before the first word, after a longer silence (Andrist et al. 2013)


@dataclass(frozen=True)
class StateTrack:
    """Spans in order of time whose label is a state; an infinite end is the end of the sound."""

    spans: tuple[Span, ...]


def load_states(path: Path | str) -> StateTrack:
    """Read a track from CSV (by the suffix) or JSON. Raises InputError (one line) for an invalid file."""
    path = Path(path)
    text = read_text(path, "track of states")
    try:
        rows = _rows_of_csv(text) if path.suffix.lower() == ".csv" else _rows_of_json(parse_json(text))
        return _checked(rows)
    except (ValueError, csv.Error) as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise InputError(f"{path}: {error}") from None


def _rows_of_csv(text: str) -> list[dict[str, Any]]:
    reader = csv.DictReader(text.splitlines())
    if set(reader.fieldnames or ()) != set(COLUMNS):
        raise ValueError(f"columns should be {', '.join(COLUMNS)}, got {', '.join(reader.fieldnames or ('none',))}")
    rows = list(reader)
    for number, row in enumerate(rows, 1):
        if None in row or None in row.values():
            raise ValueError(f"state {number} should have {len(COLUMNS)} columns")
    return [{**row, "end_s": row["end_s"] or None} for row in rows]


def _rows_of_json(content: Any) -> list[dict[str, Any]]:
    schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if schema != SCHEMA:
        raise ValueError(f"schema should be {SCHEMA}, got {schema}")
    rows = content.get("states")
    if set(content) != {"schema", "states"} or not isinstance(rows, list):
        raise ValueError(f"should hold schema and a list of states, got {', '.join(sorted(content))}")
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict) or not {"start_s", "state"} <= set(row) <= set(COLUMNS):
            raise ValueError(f"state {number} should have start_s, state and perhaps end_s, got {row}")
    return rows


def _checked(rows: Sequence[dict[str, Any]]) -> StateTrack:
    """Validate rows; a missing end becomes the start of the next state."""
    if not rows:
        raise ValueError("should hold at least one state")
    starts = [_number(f"start_s of state {number}", row["start_s"]) for number, row in enumerate(rows, 1)]
    spans = []
    for number, (row, start, following) in enumerate(zip(rows, starts, [*starts[1:], math.inf], strict=True), 1):
        end = following if row.get("end_s") is None else _number(f"end_s of state {number}", row["end_s"])
        if row["state"] not in STATES:
            raise ValueError(f"state {number} should be one of {', '.join(STATES)}, got {row['state']}")
        if start < 0 or end < start + MIN_STATE_S or end > following:
            raise ValueError(
                f"state {number} should start at 0 s or later, last {MIN_STATE_S} s or longer and end before the next, "
                f"got {start:g} to {end:g} s"
            )
        spans.append(Span(start, end, row["state"]))
    return StateTrack(tuple(spans))


def _number(what: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{what} should be a finite number, got {value!r}")
    return number


def resolve_states(track: StateTrack | str, turns: Annotation, seconds: float) -> tuple[Span, ...]:
    """States that cover the whole sound: those of the track (none if it is AUTO), and elsewhere those of the sounds.

    Raises InputError for a track that starts after the sound.
    """
    given = track.spans if isinstance(track, StateTrack) else ()
    if given and given[0].start_s >= seconds:
        raise InputError(
            f"states: should start before the end of the sound, {seconds:.2f} s, got {given[0].start_s:g} s"
        )
    return _merged(_paint(seconds, [*states_of_turns(turns, seconds), *given]))


def states_of_turns(turns: Annotation, seconds: float) -> tuple[Span, ...]:
    """The states that the sounds show, over the whole time.

    Listening in the partner's turns; thinking in pauses of the own turn and before its first word; idle else.
    """
    own = turns.speaking
    painted = [Span(0.0, seconds, "idle")]
    for one, following in pairwise(own):
        pause_s = following.start_s - one.end_s
        if pause_s < IDLE_S:
            painted.append(Span(one.end_s, following.start_s, "speaking" if pause_s < THINKING_S else "thinking"))
    painted += [Span(span.start_s, span.end_s, "listening") for span in turns.listening]
    for span in own:
        silent_s = max([0.0, *(each.end_s for each in (*own, *turns.partner) if each.end_s <= span.start_s)])
        if span.start_s - silent_s >= THINKING_S:
            painted.append(Span(max(silent_s, span.start_s - PLANNING_S), span.start_s, "thinking"))
    painted += [Span(span.start_s, span.end_s, "speaking") for span in own]
    return _merged(_paint(seconds, painted))


def _paint(seconds: float, spans: Iterable[Span]) -> list[Span]:
    """Spans without overlap, of which later ones cover earlier ones."""
    found: list[Span] = []
    for span in spans:
        start, end = max(span.start_s, 0.0), min(span.end_s, seconds)
        if end <= start:
            continue
        kept = []
        for old in found:
            kept += [
                Span(old.start_s, min(old.end_s, start), old.label),
                Span(max(old.start_s, end), old.end_s, old.label),
            ]
        found = [each for each in kept if each.end_s > each.start_s] + [Span(start, end, span.label)]
    return sorted(found, key=lambda each: each.start_s)


def _merged(spans: Sequence[Span]) -> tuple[Span, ...]:
    """Neighbours of the same state as one; states shorter than MIN_STATE_S join the one before."""
    found: list[Span] = []
    for span in spans:
        if found and (span.label == found[-1].label or span.end_s - span.start_s < MIN_STATE_S):
            found[-1] = replace(found[-1], end_s=span.end_s)
        else:
            found.append(span)
    return tuple(found)


def spans_of(states: Sequence[Span], state: State) -> tuple[Span, ...]:
    """The spans of one state."""
    return tuple(span for span in states if span.label == state)


def with_states(turns: Annotation, states: Sequence[Span]) -> Annotation:
    """Turns in which the subject listens when the states say so.

    Without the partner's voice, each span of listening counts as one phrase of the partner.
    """
    listening = spans_of(states, "listening")
    partner = turns.partner or tuple(replace(span, label="") for span in listening)
    return replace(turns, listening=tuple(replace(span, label="") for span in listening), partner=partner)
