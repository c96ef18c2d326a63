"""Rows of a table under several seeds of training and sampling, through the result store: nothing is made twice.

Used by: pipelines.combinations, pipelines.face_table, pipelines.tables. What all rows and seeds share (corpus, fit,
embedding, codebooks, critic) is made first; then the models run side by side, one a process. Killed, it goes on: every
model, what follows its training and its row are kept under `store` (store.py).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.recipe import CHECKOUT, OWN_CORPUS, Call, recipe
from talkingeyes.orchestration.run import Report, Workspace, clip_parallel, each
from talkingeyes.orchestration.store import Entry, obtain

SEEDS = (0, 1, 2)
FIGURES = "figures.json"


@dataclass(frozen=True)
class Made:
    """A row under one seed: where its figures are, and of a model its samples (if the row reads them) and the model
    itself, with the CPU seconds of its training (None if `dvc repro` trained it)."""

    name: str
    figures: Path
    samples: Path | None = None
    model: Path | None = None
    training_cpu_s: float | None = None


@dataclass(frozen=True)
class Kind:
    """What a row is: the name of its entries in the store, the code that it follows from, what it reads, its measure.

    `measure` writes figures.json. `models`: those who are rows; real motion (`references`) is measured alone. `after`:
    the stages that follow the training of a model and that the row reads.
    """

    stage: str
    code: tuple[str, ...]
    reads: tuple[str, ...]
    sections: tuple[str, ...]
    measure: Callable[[Call, Workspace], Report]
    models: tuple[str, ...]
    references: tuple[str, ...]
    after: tuple[str, ...] = ("sample",)


@dataclass(frozen=True)
class Rows:
    """All rows, by name, one a seed; and where what they share lies, by stage."""

    by_name: dict[str, list[Made]]
    data: dict[str, Path]


@dataclass(frozen=True)
class Asked:
    """What the command line asks for: where to write, which seeds, what is set in conf/, and words of its own."""

    out: Path
    seeds: list[int]
    overrides: list[str]
    words: dict[str, list[str]]


def asked(arguments: Sequence[str], words: Sequence[str] = ()) -> Asked:
    """The arguments, of which `words` (as in word=a,b) are a table's own. Raises InputError for seeds that are none."""
    left, out = list(arguments), CHECKOUT / "docs"
    if "--out" in left:
        at = left.index("--out")
        if at + 1 == len(left):
            raise InputError("--out: should name a folder, got none")
        out = Path(left[at + 1])
        left[at : at + 2] = []
    given = {word: _values(left, word) for word in ("seeds", *words)}
    try:
        seeds = [int(seed) for seed in given.pop("seeds")] or list(SEEDS)
    except ValueError:
        came = next(text for text in left if text.startswith("seeds="))
        raise InputError(f"seeds: should be numbers such as seeds=0,1,2, got {came.removeprefix('seeds=')!r}") from None
    overrides = [text for text in left if text.partition("=")[0] not in ("seeds", *words)]
    return Asked(out, seeds, overrides, given)


def _values(arguments: Sequence[str], word: str) -> list[str]:
    return [value for text in arguments if text.startswith(f"{word}=") for value in text.partition("=")[2].split(",")]


def of_seeds(overrides: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """The composition under each seed. A corpus from elsewhere is named as seen from anywhere."""
    made = [compose([*overrides, f"train.seed={seed}", f"sample.seed={seed}"]) for seed in seeds]
    for params in made:
        if params["corpus"] != OWN_CORPUS:
            params["corpus"] = str(Path(params["corpus"]).resolve())
    return made


def rows(made: Sequence[Mapping[str, Any]], kind: Kind, critic: bool, title: str) -> Rows:
    """Every row of every seed; references have one."""
    params, entries = made[0], dict[Path, Entry]()
    for call in shared(params, kind.models, critic):
        entries[call.folder] = _obtain(params, call, entries)
    work = [(params, name) for name in kind.references] + [(each, name) for each in made for name in kind.models]
    found: dict[str, list[Made]] = {}
    for one in each(partial(_row, kind, entries), work, params["machine"]["jobs"], f"{title}: rows"):
        found.setdefault(one.name, []).append(one)
    return Rows(found, {folder.parts[1]: entry.output for folder, entry in entries.items()})


def shared(params: Mapping[str, Any], models: Iterable[str], critic: bool) -> list[Call]:
    """What all rows and seeds share."""
    priors = {params["model"][name]["prior"] for name in _with_parts(params, models)} - {None}
    own = [("synthesize",)] if params["corpus"] == OWN_CORPUS else []
    order = [*own, ("fit",), ("embed",), *(("pretrain", prior) for prior in sorted(priors)), *[("critic",)] * critic]
    return recipe(params, order)


def _with_parts(params: Mapping[str, Any], models: Iterable[str]) -> list[str]:
    """Models, each after those that it is made of."""
    found = []
    for name in models:
        found += [*_with_parts(params, params["model"][name].get("made_of", ())), name]
    return found


def _obtain(params: Mapping[str, Any], call: Call, upstream: Mapping[Path, Entry]) -> Entry:
    def make(of: Call, workspace: Workspace) -> Report:
        print("==", of.stage, *of.names, file=sys.stderr)
        with clip_parallel(params["machine"]):
            report: Report = importlib.import_module(f"pipelines.{of.stage}").run(workspace, *of.names)
        return report

    return obtain(Path(params["store"]), call, params, upstream, make)


def _row(kind: Kind, shared_entries: Mapping[Path, Entry], work: tuple[Mapping[str, Any], str]) -> Made:
    """Train one model of one seed, run what follows the training, and measure it; real motion is measured alone."""
    params, name = work
    entries, of_model = dict(shared_entries), name not in kind.references
    if of_model:
        order = [("train", each) for each in _with_parts(params, [name])]
        for call in recipe(params, [*order, *((stage, name) for stage in kind.after)]):
            entries[call.folder] = _obtain(params, call, entries)
    own = tuple(f"data/{stage}/{name}" for stage in (*kind.after, "train") if of_model)
    corpus = "data/synthesize" if params["corpus"] == OWN_CORPUS else params["corpus"]
    reads = (corpus, "data/fit", "data/embed", *kind.reads, *own)
    call = Call(kind.stage, name, reads, kind.code, kind.sections)
    figures = obtain(Path(params["store"]), call, params, entries, kind.measure).output / FIGURES
    if not of_model:
        return Made(name, figures)
    samples, model = (entries.get(Path("data", stage, name)) for stage in ("sample", "train"))
    assert model is not None
    return Made(name, figures, samples.output if samples else None, model.output, model.cpu_s)
