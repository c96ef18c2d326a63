"""Design of a perception study: conditions compared in pairs, questions, and settings of the films.

The designs of the papers are files in designs/; your own file has the same keys (docs/study.md).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from talkingeyes.core.containers import read_yaml
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, bounds_error, validate_section

DESIGNS_FOLDER = Path(__file__).parent / "designs"
Name = Annotated[str, Field(pattern=r"^[a-z0-9_]{1,40}$")]
MotionPart = Literal["head", "gaze", "lid", "jaw", "expression"]


class Condition(Settings):
    """A compared condition: its label in tables, and the source of its motions in the pipeline's data.

    `source` is `truth`, or a folder below data/; `lids` says whether the lids of the rendered head follow gaze.
    """

    label: str
    source: str
    lids: Literal["follow", "static"]


class Question(Settings):
    """A question about each pair, answered by left or right."""

    name: Name
    label: str
    text: str


class Stratum(Settings):
    """Clips of one kind: films exist for `pool` of them; each participant sees `pairs` of them in each comparison.

    `emotion` null accepts any emotion; `seconds` null uses whole clips, a number their beginning.
    """

    name: Name
    emotion: str | None
    seconds: Annotated[float, Field(gt=0, le=600)] | None
    pool: Annotated[int, Field(ge=1)]
    pairs: Annotated[int, Field(ge=1)]

    @model_validator(mode="after")
    def _pool_is_enough(self) -> Stratum:
        if self.pairs > self.pool:
            raise bounds_error("pairs should be at most pool", f"{self.pairs} of {self.pool}")
        return self


class AttentionCheck(Settings):
    """The attention check: a film of a condition paired with the same film with an obvious fault.

    `ends_study`: choosing the faulty film ends the study for the participant.
    """

    condition: Name
    fault: Literal["late_sound", "upside_down"]
    ends_study: bool


class Design(Settings):
    """A study. Films take `varied_parts` from their condition and `shared_parts` from the truth; other parts are at
    rest. `participants` is the number in the paper."""

    title: str
    paper: str
    introduction: str
    conditions: dict[Name, Condition]
    comparisons: tuple[tuple[Name, Name], ...]
    questions: Annotated[tuple[Question, ...], Field(min_length=1)]
    strata: Annotated[tuple[Stratum, ...], Field(min_length=1)]
    varied_parts: tuple[MotionPart, ...]
    shared_parts: tuple[MotionPart, ...]
    camera: str
    attention: AttentionCheck
    participants: Annotated[int, Field(ge=1)]
    layout: Literal["preference", "split", "lengths"]
    test: Literal["wilcoxon", "binomial"]

    @model_validator(mode="after")
    def _names_are_known(self) -> Design:
        for name in (*(name for pair in self.comparisons for name in pair), self.attention.condition):
            if name not in self.conditions:
                raise bounds_error(f"conditions should be {', '.join(self.conditions)}", name)
        if any(first == second for first, second in self.comparisons):
            raise bounds_error("a comparison should be of two conditions", "one with itself")
        return self


def names() -> list[str]:
    """Names of the packaged designs."""
    return sorted(path.stem for path in DESIGNS_FOLDER.glob("*.yaml"))


def load_design(name: str) -> Design:
    """A design by name, or from a .yaml file. Raises InputError (one line)."""
    path = DESIGNS_FOLDER / f"{name}.yaml" if name in names() else Path(name)
    if path.suffix != ".yaml":
        raise InputError(f"design: should be {', '.join(names())} or a .yaml file, got {name!r}")
    return validate_section(str(path), Design, read_yaml(path, "design"))
