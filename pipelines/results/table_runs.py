"""Rows of a table with several seeds of training and sampling, through the result store, so nothing runs twice.

Used by: pipelines.results.face_table, pipelines.results.tables. What all rows and seeds share (corpus, fit,
embedding, codebooks, critic) is computed first; then the models run in parallel, one per process. An interrupted run
resumes: every model, the stages after its training and its row are kept in the result store.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.result_store import StoredResult, get_or_run
from talkingeyes.orchestration.run import Report, Workspace, parallel_backend, parallel_map
from talkingeyes.orchestration.stage_graph import DEFAULT_CORPUS, REPOSITORY_ROOT, StageCall, stage_calls

SEEDS = (0, 1, 2)
METRICS_FILE = "metrics.json"
AnyResult = TypeVar("AnyResult", bound="SeedResult")


@dataclass(frozen=True)
class RowResult:
    """A row with one seed: the paths of its metrics, and for a model those of its samples and of the model."""

    name: str
    figures: Path
    samples: Path | None = None
    model: Path | None = None


@dataclass(frozen=True)
class RowSpec:
    """Definition of the rows: the name of their entries in the store, their code, their inputs, and their measurement.

    `measure` writes metrics.json. `models` are the models that are rows; real motion (`references`) is only measured.
    """

    stage: str
    code_deps: tuple[str, ...]
    reads: tuple[str, ...]
    sections: tuple[str, ...]
    measure: Callable[[StageCall, Workspace], Report]
    models: tuple[str, ...]
    references: tuple[str, ...]


@dataclass(frozen=True)
class TableRows:
    """All rows by name, one per seed; and the paths of their shared data, by stage."""

    by_name: dict[str, list[RowResult]]
    data: dict[str, Path]


@dataclass(frozen=True)
class TableOptions:
    """Options of the command line: output folder, seeds, overrides of conf/, and options of the table."""

    out: Path
    seeds: list[int]
    overrides: list[str]
    words: dict[str, list[str]]


def parse_arguments(arguments: Sequence[str], words: Sequence[str] = ()) -> TableOptions:
    """Parse the arguments; `words` (as in word=a,b) are options of the table. Raises InputError for invalid seeds."""
    left, out = list(arguments), REPOSITORY_ROOT / "docs/results"
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
    return TableOptions(out, seeds, overrides, given)


def _values(arguments: Sequence[str], word: str) -> list[str]:
    return [value for text in arguments if text.startswith(f"{word}=") for value in text.partition("=")[2].split(",")]


def configs_by_seed(overrides: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """The composition with each seed; the path of an external corpus is made absolute."""
    made = [compose([*overrides, f"train.seed={seed}", f"sample.seed={seed}"]) for seed in seeds]
    for params in made:
        if params["corpus"] != DEFAULT_CORPUS:
            params["corpus"] = str(Path(params["corpus"]).resolve())
    return made


def configuration_hash(params: Mapping[str, Any], sections: Iterable[str], models: Iterable[str]) -> str:
    """Hash of some sections of a composition, and of some models and what they were pretrained on."""
    chosen = {name: params["model"][name] for name in models}
    tokenizers = {each["tokenizer"] for each in chosen.values()} - {None}
    pretraining = {name: params["pretrain"][name] for name in tokenizers}
    content = {name: params[name] for name in sections} | {"model": chosen, "pretrain": pretraining}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


class SeedResult(Protocol):
    """What a file of results of a single seed holds."""

    @property
    def seed(self) -> int: ...

    @property
    def configuration(self) -> str: ...


def read_seed_results(
    folder: Path,
    writer: str,
    parse: Callable[[Any], tuple[str, AnyResult]],
    configurations: Mapping[str, str] | None = None,
) -> dict[str, list[AnyResult]]:
    """The results of single seeds of all JSON files in a folder, by name, then by seed; `parse` gives name and result.

    Raises InputError if a file is none of `writer`'s, or was computed with another configuration than that of its name
    (by default, that of the name's first file).
    """
    expected = dict(configurations or {})
    found: dict[str, list[AnyResult]] = {}
    for path in sorted(folder.glob("*.json")):
        try:
            name, result = parse(json.loads(path.read_text()))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: should be a result of {writer}, got {error!r}") from None
        configuration = expected.setdefault(name, result.configuration)
        if result.configuration != configuration:
            raise InputError(
                f"{path}: should have configuration {configuration}, got {result.configuration}; "
                "remove the file, or give another --out"
            )
        found.setdefault(name, []).append(result)
    return {name: sorted(seeds, key=lambda each: each.seed) for name, seeds in found.items()}


def compute_rows(made: Sequence[Mapping[str, Any]], kind: RowSpec, critic: bool, title: str) -> TableRows:
    """Compute every row with every seed; references have a single one."""
    params, entries = made[0], dict[Path, StoredResult]()
    for call in shared_calls(params, kind.models, critic):
        entries[call.folder] = _obtain(params, call, entries)
    work = [(params, name) for name in kind.references] + [(each, name) for each in made for name in kind.models]
    found: dict[str, list[RowResult]] = {}
    for one in parallel_map(partial(_row, kind, entries), work, params["machine"]["jobs"], f"{title}: rows"):
        found.setdefault(one.name, []).append(one)
    return TableRows(found, {folder.parts[1]: entry.output for folder, entry in entries.items()})


def shared_calls(params: Mapping[str, Any], models: Iterable[str], critic: bool) -> list[StageCall]:
    """The calls that all rows and seeds share."""
    tokenizers = {params["model"][name]["tokenizer"] for name in _with_parts(params, models)} - {None}
    own = [("synthesize",)] if params["corpus"] == DEFAULT_CORPUS else []
    order = [
        *own,
        ("fit",),
        ("embed",),
        *(("pretrain", tokenizer) for tokenizer in sorted(tokenizers)),
        *[("critic",)] * critic,
    ]
    return stage_calls(params, order)


def _with_parts(params: Mapping[str, Any], models: Iterable[str]) -> list[str]:
    """Models, each after the models that it combines."""
    found = []
    for name in models:
        found += [*_with_parts(params, params["model"][name].get("source_models", ())), name]
    return found


def _obtain(params: Mapping[str, Any], call: StageCall, upstream: Mapping[Path, StoredResult]) -> StoredResult:
    def make(of: StageCall, workspace: Workspace) -> Report:
        print("==", of.stage, *of.names, file=sys.stderr)
        with parallel_backend(params["machine"]):
            report: Report = importlib.import_module(f"pipelines.{of.stage}").run(workspace, *of.names)
        return report

    return get_or_run(Path(params["result_store"]), call, params, upstream, make)


def _row(kind: RowSpec, shared_entries: Mapping[Path, StoredResult], work: tuple[Mapping[str, Any], str]) -> RowResult:
    """Train and sample one model with one seed, and measure it; real motion is only measured."""
    params, name = work
    entries, of_model = dict(shared_entries), name not in kind.references
    if of_model:
        order = [("train", each) for each in _with_parts(params, [name])]
        for call in stage_calls(params, [*order, ("sample", name)]):
            entries[call.folder] = _obtain(params, call, entries)
    own = tuple(f"data/{stage}/{name}" for stage in ("sample", "train") if of_model)
    corpus = "data/synthesize" if params["corpus"] == DEFAULT_CORPUS else params["corpus"]
    reads = (corpus, "data/fit", "data/embed", *kind.reads, *own)
    call = StageCall(kind.stage, name, reads, kind.code_deps, kind.sections)
    figures = get_or_run(Path(params["result_store"]), call, params, entries, kind.measure).output / METRICS_FILE
    if not of_model:
        return RowResult(name, figures)
    samples, model = (entries[Path("data", stage, name)].output for stage in ("sample", "train"))
    return RowResult(name, figures, samples, model)
