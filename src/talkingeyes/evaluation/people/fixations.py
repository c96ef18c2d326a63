"""Fixations of people by conversational state, and the reader of the recorded ones.

Recorded people: fixations of twelve people in remote conversation, an eye tracker at 90 Hz (Dembinsky, Watanabe, Dengel
& Ishimaru 2024, ETRA). A segment is a stretch without a lost sample inside a turn; it lasts a second or so, and the
stretch goes on behind both of its ends. Fixations are therefore in segments, and measures respect the cuts.

Two consecutive fixations nearer than MERGE_DEG are one: the published detector splits fixations by its noise (half of
all steps are shorter). Directions are degrees of yaw (to the subject's left) and pitch (up).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from talkingeyes.core.containers import read_csv
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.gaze_datasets import CONVERSATION_RATE_HZ, MAX_SHIFT_S, read_conversation
from talkingeyes.evaluation.detectors.gaze_states import RADIUS_DEG, densest_direction

RECORDED_STATES = {"SPEAK": "speaking", "LISTEN": "listening"}  # DIALOGUE, quick exchanges, is neither
VALIDATION_PEOPLE = ("08", "09", "10", "11")  # the last four by id: nothing is estimated from them
MERGE_DEG = 1.5
MIN_HOME_S = 20.0  # of listening, to find the home in it
HOME_STEP_S = 0.05


@dataclass(frozen=True)
class FixationRecord:
    """N fixations of one person in one state, in order of time within each segment."""

    segment: Int[ndarray, " N"]
    onset_s: Float[ndarray, " N"]
    duration_s: Float[ndarray, " N"]
    centre_deg: Float[ndarray, "N 2"]

    def __len__(self) -> int:
        return len(self.segment)

    @cached_property
    def continues(self) -> Bool[ndarray, " M"]:
        """Whether the next fixation is in the same segment, for all but the last fixation."""
        return np.asarray(self.segment[1:] == self.segment[:-1])

    @cached_property
    def is_first(self) -> Bool[ndarray, " N"]:
        """Fixations whose onset was not seen, because the segment begins with them."""
        return np.concatenate([[True], ~self.continues])[: len(self)]

    @cached_property
    def is_last(self) -> Bool[ndarray, " N"]:
        """Fixations whose end was not seen."""
        return np.concatenate([~self.continues, [True]])[-len(self) :] if len(self) else np.zeros(0, bool)

    @cached_property
    def time_s(self) -> Float[ndarray, " N"]:
        """Observed time that each fixation accounts for: to the onset of the next one, or to its end."""
        time = self.duration_s.copy()
        time[:-1][self.continues] = np.diff(self.onset_s)[self.continues]
        return np.asarray(time)

    @cached_property
    def shifts_deg(self) -> Float[ndarray, "M 2"]:
        """Shifts between successive fixations of a segment."""
        return np.asarray(np.diff(self.centre_deg, axis=0)[self.continues])


@dataclass(frozen=True)
class Person:
    """Merged fixations of a person, by state."""

    name: str
    records: Mapping[str, FixationRecord]

    @cached_property
    def home_deg(self) -> Float[ndarray, " 2"]:
        """The place of the partner: where fixations are densest while listening.

        With less than MIN_HOME_S of listening, it is the densest place of both states.
        """
        listening = self.records["listening"]
        used = [listening] if listening.duration_s.sum() >= MIN_HOME_S else list(self.records.values())
        centres, durations = (
            np.concatenate([getattr(each, name) for each in used]) for name in ("centre_deg", "duration_s")
        )
        repeated = np.repeat(centres, np.ceil(durations / HOME_STEP_S).astype(int), axis=0)
        return densest_direction(repeated, RADIUS_DEG)

    def away(self, state: str) -> Bool[ndarray, " N"]:
        """Fixations further than RADIUS_DEG from the partner."""
        away = self.records[state].centre_deg - self.home_deg
        return np.asarray((away**2).sum(axis=1) > RADIUS_DEG**2)


def join_records(records: Sequence[FixationRecord]) -> FixationRecord:
    """Records one after the other, in segments of their own."""
    counts = [record.segment.max(initial=-1) + 1 for record in records]
    segments = [record.segment + start for record, start in zip(records, np.cumsum([0, *counts]), strict=False)]
    names = ("onset_s", "duration_s", "centre_deg")
    arrays = (np.concatenate([getattr(each, name) for each in records]) for name in names)
    return FixationRecord(np.concatenate(segments), *arrays)


def merge_fixations(record: FixationRecord) -> FixationRecord:
    """Join consecutive fixations nearer than MERGE_DEG; a gap above 0.2 s between fixations begins a segment."""
    first: list[int] = []
    last: list[int] = []
    centres: list[ndarray] = []
    segments: list[int] = []
    weight = 0.0
    ends = record.onset_s + record.duration_s
    for i in range(len(record)):
        joined = i > 0 and record.continues[i - 1] and record.onset_s[i] - ends[i - 1] < MAX_SHIFT_S
        if joined and np.hypot(*(record.centre_deg[i] - centres[-1])) < MERGE_DEG:
            weight += record.duration_s[i]
            centres[-1] = centres[-1] + (record.centre_deg[i] - centres[-1]) * record.duration_s[i] / weight
            last[-1] = i
            continue
        segments.append((segments[-1] + (not joined)) if segments else 0)
        first.append(i)
        last.append(i)
        centres.append(record.centre_deg[i])
        weight = record.duration_s[i]
    onset = record.onset_s[first]
    return FixationRecord(np.array(segments, int), onset, ends[last] - onset, np.reshape(centres, (-1, 2)))


def read_people(path: Path) -> list[Person]:
    """Read the recorded people, sorted by id. Raises InputError if the file is not their table."""
    fixations, table = read_conversation(path), read_csv(path)
    if "segment" not in table.column_names:
        raise InputError(f"{path}: should have a column segment, got {', '.join(table.column_names)}")
    segments = np.asarray(table["segment"].to_numpy())
    names, states = np.array([each.zfill(2) for each in fixations.person]), np.array(fixations.state)
    people = []
    for name in sorted(set(names)):
        records = {}
        for recorded, state in RECORDED_STATES.items():
            rows = np.flatnonzero((names == name) & (states == recorded))
            rows = rows[np.lexsort((fixations.onset_s[rows], segments[rows]))]
            centre = np.degrees(fixations.centre_rad[rows])
            duration_s = np.rint(fixations.duration_s[rows] * CONVERSATION_RATE_HZ) / CONVERSATION_RATE_HZ
            arrays = (segments[rows], fixations.onset_s[rows], duration_s, centre)
            records[state] = merge_fixations(FixationRecord(*arrays))
        if any(len(record) for record in records.values()):
            people.append(Person(str(name), records))
    if not people:
        raise InputError(f"{path}: should hold fixations of people who speak or listen, got none")
    return people


def split_people(people: Sequence[Person]) -> tuple[list[Person], list[Person]]:
    """The people that estimates may use, and those kept for validation."""
    return (
        [each for each in people if each.name not in VALIDATION_PEOPLE],
        [each for each in people if each.name in VALIDATION_PEOPLE],
    )
