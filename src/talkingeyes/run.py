"""The only shell: workspace folders, validated sections, seeds and threads, progress, MLflow. Stages are called through it.

A stage in pipelines/ is a function `(workspace[, name]) -> Report`; `main` makes a command of it.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import yaml

from talkingeyes.errors import InputError
from talkingeyes.settings import Settings

S = TypeVar("S", bound=Settings)
A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True)
class Report:
    """What a stage reports to MLflow. Timings never go to metrics.json, so they are logged here, not returned in files."""

    metrics: Mapping[str, float] = field(default_factory=dict)
    artifacts: Sequence[Path] = ()


@dataclass(frozen=True)
class Workspace:
    """A folder that holds data/ and the resolved composition (params.yaml) that fills it."""

    root: Path
    params: Mapping[str, Any]

    @classmethod
    def open(cls, root: Path) -> Workspace:
        """The workspace in `root`. Raises InputError if its params.yaml is missing or not a mapping."""
        path = root / "params.yaml"
        try:
            params = yaml.safe_load(path.read_text())
        except (OSError, yaml.YAMLError) as error:
            raise InputError(f"{path}: cannot be read ({error}); `make params` writes it") from None
        if not isinstance(params, dict):
            raise InputError(f"{path}: should be a mapping of sections; `make params` writes it")
        return cls(root, params)

    def settings(self, section: str, kind: type[S]) -> S:
        """The section at a dotted key, validated. Raises InputError naming the key, the bound and the value that came."""
        node: Any = self.params
        for key in section.split("."):
            if not isinstance(node, Mapping) or key not in node:
                raise InputError(f"params: section {section} is missing; `make params` writes it from conf/")
            node = node[key]
        return validated(section, kind, node)

    @property
    def corpus(self) -> Path:
        """The corpus that every stage after `synthesize` reads."""
        return self.root / str(self.params["corpus"])

    @property
    def jobs(self) -> int:
        """How many processes clip-parallel work uses."""
        return int(self.params["machine"]["jobs"])

    def data(self, *parts: str) -> Path:
        """A path under data/."""
        return self.root.joinpath("data", *parts)

    @contextmanager
    def output(self, *parts: str) -> Iterator[Path]:
        """A new folder that becomes data/<parts> only when the block ends well; a killed stage leaves no half output."""
        final = self.data(*parts)
        partial = final.with_name(f".{final.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            yield partial
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        shutil.rmtree(final, ignore_errors=True)
        partial.rename(final)


def validated(section: str, kind: type[S], node: Any) -> S:
    """A section as its frozen settings. Raises InputError: one line with the key, the bound and the value that came."""
    try:
        return kind.model_validate(node)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join([section, *map(str, first["loc"])])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise InputError(f"{key}: {first['msg']}, got {first['input']!r}{more}") from None


def each(function: Callable[[A], B], items: Iterable[A], jobs: int, title: str) -> Iterator[B]:
    """The one joblib call for clip-parallel work: results in order, with a progress bar. Memory does not grow with items."""
    import joblib

    items = list(items)
    tasks = (joblib.delayed(function)(item) for item in items)
    results = joblib.Parallel(n_jobs=jobs, return_as="generator", pre_dispatch="4*n_jobs")(tasks)
    yield from progress(results, title, len(items))


def progress(items: Iterable[A], title: str, total: int | None = None) -> Iterable[A]:
    """The progress bar of everything that takes longer than a few seconds."""
    from tqdm import tqdm

    return tqdm(items, desc=title, total=total, mininterval=0.5, file=sys.stderr)


def quiet() -> None:
    """One thread a process, and no telemetry of any dependency. Called before they are imported."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    os.environ.update(
        MLFLOW_DISABLE_TELEMETRY="true",
        DO_NOT_TRACK="true",
        DVC_NO_ANALYTICS="1",
        RAY_USAGE_STATS_ENABLED="0",
        HF_HUB_DISABLE_TELEMETRY="1",
    )
