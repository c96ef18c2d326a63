"""A study on disk: its design (study.json), its films under opaque names, and the answers.

study.json          schema, design, seed, clips of each stratum, films: {id: {condition, stratum, clip}}
films/<id>.mp4
answers.sqlite      created by the first participant
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from talkingeyes.apps.study.answers import AnswerDatabase
from talkingeyes.apps.study.counterbalancing import ATTENTION_CHECK, Pair, assign_pairs
from talkingeyes.apps.study.design import Design
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section

SCHEMA = "talkingeyes.study/1"


@dataclass(frozen=True)
class Film:
    """Identity of a film: a condition (or the fault of the attention check), a stratum, a clip."""

    condition: str
    stratum: str
    clip: str


@dataclass(frozen=True)
class Study:
    """A study that can be served. `clips` holds the pool of each stratum, and the clip of the attention check."""

    root: Path
    design: Design
    seed: int
    clips: Mapping[str, tuple[str, ...]]

    @cached_property
    def films(self) -> dict[str, Film]:
        """All films by name."""
        return {film_id(self.seed, film): film for film in required_films(self.design, self.clips)}

    @property
    def answers(self) -> AnswerDatabase:
        return AnswerDatabase(self.root / "answers.sqlite")

    def film(self, film_id: str) -> Path:
        """The file of a film."""
        return self.root / "films" / f"{film_id}.mp4"

    def pairs(self, number: int) -> tuple[Pair, ...]:
        """The pairs of a participant."""
        return assign_pairs(self.design, self.clips, self.seed, number)

    def names(self, pair: Pair) -> tuple[str, str]:
        """Names of the films of a pair, left and right."""
        a, b = (film_id(self.seed, Film(name, pair.stratum, pair.clip)) for name in (pair.a, pair.b))
        return (a, b) if pair.a_left else (b, a)

    def save(self) -> None:
        """Write study.json."""
        films = {name: vars(film) for name, film in self.films.items()}
        content = {"schema": SCHEMA, "seed": self.seed, "clips": self.clips, "films": films}
        text = json.dumps({**content, "design": self.design.model_dump(mode="json")}, indent=1)
        (self.root / "study.json").write_text(text + "\n")

    @classmethod
    def load(cls, root: Path) -> Study:
        """Read a study. Raises InputError if it is invalid, or lacks a film."""
        path = root / "study.json"
        content = read_json(path, "study")
        with reading(path, "study; `talkingeyes study make` writes one"):
            if content["schema"] != SCHEMA:
                raise ValueError(f"schema should be {SCHEMA}")
            clips = {str(name): tuple(map(str, pool)) for name, pool in content["clips"].items()}
            study = cls(root, validate_section(str(path), Design, content["design"]), int(content["seed"]), clips)
            missing = [name for name in study.films if not study.film(name).is_file()]
        if missing:
            raise InputError(f"{root}: should hold {len(study.films)} films, got none called {missing[0]}.mp4")
        return study


def required_films(design: Design, clips: Mapping[str, tuple[str, ...]]) -> list[Film]:
    """The films that a study needs: each compared condition of each clip, and the two of the attention check."""
    wanted = sorted({name for pair in design.comparisons for name in pair})
    films = [
        Film(name, stratum.name, clip)
        for stratum in design.strata
        for clip in clips.get(stratum.name, ())
        for name in wanted
    ]
    check = clips[ATTENTION_CHECK][0]
    return [
        *films,
        *(Film(name, ATTENTION_CHECK, check) for name in (design.attention.condition, design.attention.fault)),
    ]


def film_id(seed: int, film: Film) -> str:
    """A name that does not reveal the condition."""
    return hashlib.blake2b(f"{seed}/{film.condition}/{film.stratum}/{film.clip}".encode(), digest_size=10).hexdigest()
