"""Answers of a study in sqlite, anonymous: a participant is a random token and a number.

No names, addresses, times or browsers are stored. Participants resume after their last answer, even if the page was
closed or the server restarted. An answer is one transaction.
"""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from talkingeyes.apps.study.counterbalancing import Pair
from talkingeyes.core.errors import InputError

MAX_PARTICIPANTS = 10_000
SCHEMA = """
create table if not exists participant (
    number integer primary key, token text unique not null, trial_index integer not null,
    attention integer, done integer not null
);
create table if not exists answer (
    participant integer not null, trial_index integer not null, question text not null,
    a text not null, b text not null, stratum text not null, clip text not null,
    a_left integer not null, chose_a integer not null,
    primary key (participant, trial_index, question)
);
"""


@dataclass(frozen=True)
class Participant:
    """Progress of a participant. `attention` is None until the attention check was answered."""

    number: int
    trial_index: int
    attention: bool | None
    done: bool


@dataclass(frozen=True)
class Answer:
    """A participant's choice for one pair and question."""

    participant: int
    question: str
    a: str
    b: str
    stratum: str
    clip: str
    a_left: bool
    chose_a: bool


@dataclass(frozen=True)
class AnswerDatabase:
    """The file of answers, created if it does not exist."""

    path: Path

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """One transaction."""
        try:
            with closing(sqlite3.connect(self.path, timeout=20, isolation_level="IMMEDIATE")) as connection:
                connection.executescript(SCHEMA)
                with connection:
                    yield connection
        except (sqlite3.Error, UnicodeDecodeError) as error:  # an error may hold bytes of a damaged file
            raise InputError(f"{self.path}: should hold the answers of a study, got: {error}") from None

    def register(self) -> str:
        """Add a participant and return the token. Raises InputError at the maximum number."""
        token = secrets.token_urlsafe(16)
        with self._open() as connection:
            connection.execute("begin immediate")
            (count,) = connection.execute("select count(*) from participant").fetchone()
            if count >= MAX_PARTICIPANTS:
                raise InputError(f"participants: should be at most {MAX_PARTICIPANTS}, got one more")
            connection.execute("insert into participant values (?, ?, 0, null, 0)", (count, token))
        return token

    def participant(self, token: str) -> Participant | None:
        """The participant with this token, if any."""
        with self._open() as connection:
            query = "select number, trial_index, attention, done from participant where token = ?"
            row = connection.execute(query, (token,)).fetchone()
        if row is None:
            return None
        number, trial_index, attention, done = row
        return Participant(number, trial_index, None if attention is None else bool(attention), bool(done))

    def add(self, who: Participant, pair: Pair, choices: Mapping[str, bool], last: bool, ends_study: bool) -> bool:
        """Store the choices for the participant's current pair: per question, whether A was chosen.

        Returns False if the pair was already answered (in another window). `last`: this is the last pair. `ends_study`:
        a failed attention check ends the study.
        """
        passed = all(choices.values())
        with self._open() as connection:
            connection.execute("begin immediate")
            moved = connection.execute(
                "update participant set trial_index = trial_index + 1, done = ?, attention = ? "
                "where number = ? and trial_index = ? and not done",
                (
                    last or (pair.attention and ends_study and not passed),
                    passed if pair.attention else who.attention,
                    who.number,
                    who.trial_index,
                ),
            ).rowcount
            if moved and not pair.attention:
                shown = (pair.a, pair.b, pair.stratum, pair.clip, pair.a_left)
                rows = [(who.number, who.trial_index, name, *shown, chosen) for name, chosen in choices.items()]
                connection.executemany("insert into answer values (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)
        return bool(moved)

    def participants(self) -> list[Participant]:
        """All participants."""
        with self._open() as connection:
            rows = connection.execute(
                "select number, trial_index, attention, done from participant order by number"
            ).fetchall()
        return [
            Participant(n, trial_index, None if seen is None else bool(seen), bool(done))
            for n, trial_index, seen, done in rows
        ]

    def valid_answers(self) -> list[Answer]:
        """Answers of participants who passed the attention check and finished."""
        columns = "participant, question, a, b, stratum, clip, a_left, chose_a"
        with self._open() as connection:
            rows = connection.execute(
                f"select {columns} from answer join participant on participant = number "
                "where attention = 1 and done = 1 order by participant, answer.trial_index, question"
            ).fetchall()
        return [
            Answer(who, question, a, b, stratum, clip, bool(left), bool(chosen))
            for who, question, a, b, stratum, clip, left, chosen in rows
        ]
