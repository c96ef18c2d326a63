"""Recorded conversations of two: when each person looks at the other, by each coder, and who has the turn.

The contact table has an interval for each look at the partner (columns pair, person, coder, start_ms, end_ms; persons
are a and b), the table of turns has who speaks (pair, start_s, end_s, speaker). All other time of a person is averted.
This is the form of Wohltjen & Wheatley 2021 (PNAS 118(37), doi 10.1073/pnas.2106645118): 24 pairs face to face.

`ConversationGaze` is what timing is measured in: recorded people and motions have the same form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Int
from numpy import ndarray

from talkingeyes.audio.annotation import Span
from talkingeyes.core.containers import read_csv
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.gaze_datasets import MAX_RECORDING_S
from talkingeyes.evaluation.detectors.gaze_states import steady_states

RATE_HZ = 25.0
TURN_GRID_S = 1.0  # the recorded turns are to the second; those of motions are rounded alike
CONTACT_COLUMNS = ("pair", "person", "coder", "start_ms", "end_ms")
TURN_COLUMNS = ("pair", "start_s", "end_s", "speaker")
PERSONS = ("a", "b")
AGREED = "agreed"
OWN, PARTNERS, NEITHERS = range(3)


@dataclass(frozen=True)
class Turns:
    """Turns of a person and of the partner, in order of time, to TURN_GRID_S."""

    own: tuple[Span, ...]
    partner: tuple[Span, ...]

    @classmethod
    def of(cls, own: Sequence[Span], partner: Sequence[Span]) -> Turns:
        """Round turns; those without length vanish, and turns of one person with nothing between them are joined."""
        labelled = [(span, who) for who, spans in enumerate((own, partner)) for span in spans]
        joined: list[tuple[Span, int]] = []
        for span, who in sorted(labelled, key=lambda each: (each[0].start_s, each[0].end_s)):
            start_s, end_s = (round(each / TURN_GRID_S) * TURN_GRID_S for each in (span.start_s, span.end_s))
            if end_s <= start_s:
                continue
            if joined and joined[-1][1] == who:
                last = joined.pop()[0]
                start_s, end_s = last.start_s, max(last.end_s, end_s)
            joined.append((Span(start_s, end_s), who))
        return cls(*(tuple(span for span, owner in joined if owner == who) for who in (OWN, PARTNERS)))

    @property
    def swapped(self) -> Turns:
        """The same turns for the partner."""
        return Turns(self.partner, self.own)

    def role(self, frames: int) -> Int[ndarray, " T"]:
        """Who has the turn in each frame at RATE_HZ: OWN, PARTNERS or NEITHERS; OWN where both have."""
        found = np.full(frames, NEITHERS)
        for who, spans in ((PARTNERS, self.partner), (OWN, self.own)):
            for span in spans:
                found[max(0, round(span.start_s * RATE_HZ)) : max(0, round(span.end_s * RATE_HZ))] = who
        return found

    def changes(self, least_s: float) -> tuple[list[float], list[float]]:
        """Times at which the person takes the turn, and gives it: between turns of both that last `least_s` or more."""
        every = sorted([(span, OWN) for span in self.own] + [(span, PARTNERS) for span in self.partner], key=_start)
        starts: list[float] = []
        ends: list[float] = []
        for (before, who), (after, other) in pairwise(every):
            if who != other and min(before.end_s - before.start_s, after.end_s - after.start_s) >= least_s:
                (starts if other == OWN else ends).append(after.start_s if other == OWN else before.end_s)
        return starts, ends


def _start(turn: tuple[Span, int]) -> float:
    return turn[0].start_s


@dataclass(frozen=True)
class ConversationGaze:
    """Gaze of a person in T frames at RATE_HZ: averted or not, and whether that is known; turns.

    `unit` is what intervals resample: the pair, or the speaker of a motion.
    """

    unit: str
    averted: Bool[ndarray, " T"]
    known: Bool[ndarray, " T"]
    turns: Turns

    @cached_property
    def steady(self) -> Bool[ndarray, " T"]:
        """The state of every frame without glances, by the rule of the detector; unknown frames keep the previous."""
        return steady_states(self.averted, self.known, RATE_HZ)


def read_conversations(contact: Path, turns: Path) -> dict[str, list[ConversationGaze]]:
    """Gaze of all people by coder, and with two coders or more where all agree (`agreed`).

    A recording of a coder lasts until the coder's last look or the last turn of the pair. Raises InputError with the
    row (the heading is row 1) for a table of another form, times that are no numbers, an interval that ends before it
    starts, and a pair without turns. The last turn of a pair may have no length: the film ends in it.
    """
    looks = read_csv(contact)
    columns = _columns(looks, CONTACT_COLUMNS, contact)
    start_s, end_s = (_seconds(looks, name, contact) for name in CONTACT_COLUMNS[3:])
    _check_order(start_s, end_s, contact, np.zeros(len(start_s), bool))
    pairs, persons, coders = columns[:3]
    _check_persons(persons, "person", contact)
    turns_of = _read_turns(turns)
    if not len(pairs):
        raise InputError(f"{contact}: should hold looks of people, got none")
    found: dict[str, list[ConversationGaze]] = {}
    for coder in sorted(set(coders)):
        for pair in sorted(set(pairs[coders == coder])):
            of_pair = (coders == coder) & (pairs == pair)
            if pair not in turns_of:
                raise InputError(f"{contact}, row {of_pair.argmax() + 2}: pair {pair} has no turns in {turns}")
            own = turns_of[pair]
            last_s = max(span.end_s for span in own.own + own.partner)
            frames = int(min(end_s[of_pair].max(), last_s) * RATE_HZ)
            if not frames:
                row = of_pair.argmax() + 2
                raise InputError(f"{contact}, row {row}: looks and turns of pair {pair} should last 40 ms or more")
            for person in PERSONS:
                averted = np.ones(frames, bool)
                chosen = of_pair & (persons == person)
                for first, end in zip(start_s[chosen], end_s[chosen], strict=True):
                    averted[round(first * RATE_HZ) : round(end * RATE_HZ)] = False
                gaze = ConversationGaze(pair, averted, np.ones(frames, bool), own if person == "a" else own.swapped)
                found.setdefault(coder, []).append(gaze)
    return found | ({AGREED: list(_agreed(list(found.values())))} if len(found) > 1 else {})


def _agreed(by_coder: Sequence[Sequence[ConversationGaze]]) -> Iterator[ConversationGaze]:
    """Known where all coders of a pair have the same state; pairs that a coder lacks are left out."""
    complete = set.intersection(*({each.unit for each in people} for people in by_coder))
    rows = ([each for each in people if each.unit in complete] for people in by_coder)
    for same in zip(*rows, strict=True):
        frames = min(len(each.averted) for each in same)
        states = np.stack([each.averted[:frames] for each in same])
        yield replace(same[0], averted=states[0], known=np.asarray((states == states[0]).all(axis=0)))


def _read_turns(path: Path) -> dict[str, Turns]:
    """Turns of each pair, those of person a as the own ones."""
    table = read_csv(path)
    columns = _columns(table, TURN_COLUMNS, path)
    start_s, end_s = (_seconds(table, name, path) for name in TURN_COLUMNS[1:3])
    pairs, speakers = columns[0], columns[3]
    _check_persons(speakers, "speaker", path)
    _check_order(start_s, end_s, path, np.append(pairs[1:] != pairs[:-1], True)[: len(pairs)])
    spans: dict[str, dict[str, list[Span]]] = {}
    for pair, start, end, speaker in zip(pairs, start_s, end_s, speakers, strict=True):
        spans.setdefault(pair, {name: [] for name in PERSONS})[speaker].append(Span(float(start), float(end)))
    return {pair: Turns.of(*(of[name] for name in PERSONS)) for pair, of in spans.items()}


def _columns(table: pa.Table, names: Sequence[str], path: Path) -> list[ndarray]:
    """The columns as text. Raises InputError for a missing one."""
    missing = [name for name in names if name not in table.column_names]
    if missing:
        raise InputError(f"{path}: should have a column {missing[0]}, got {', '.join(table.column_names)}")
    return [np.array([str(each) for each in table[name].to_pylist()], dtype=object) for name in names]


def _seconds(table: pa.Table, name: str, path: Path) -> ndarray:
    """A column of times, which its name says to be in ms or s."""
    values, unit = np.empty(table.num_rows), 1000 if name.endswith("_ms") else 1
    for row, text in enumerate(table[name].to_pylist()):
        try:
            values[row] = float(text) / unit
        except (TypeError, ValueError):
            values[row] = np.nan
        if not 0 <= values[row] < MAX_RECORDING_S:
            raise InputError(f"{path}, row {row + 2}: {name} should be a time of at least 0, within a day, got {text}")
    return values


def _check_order(start_s: ndarray, end_s: ndarray, path: Path, excused: Bool[ndarray, " N"]) -> None:
    wrong = np.flatnonzero((end_s < start_s) & ~excused)
    if len(wrong):
        row = wrong[0]
        raise InputError(
            f"{path}, row {row + 2}: should end at or after its start {start_s[row]:g} s, got {end_s[row]:g} s"
        )


def _check_persons(names: ndarray, column: str, path: Path) -> None:
    wrong = np.flatnonzero([name not in PERSONS for name in names])
    if len(wrong):
        raise InputError(f"{path}, row {wrong[0] + 2}: {column} should be a or b, got {names[wrong[0]]}")
