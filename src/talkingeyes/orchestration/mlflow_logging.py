"""Logging to MLflow: the workspace's mlflow.db, without a server. `make ui` shows it.

Experiment `stages` holds one run per call of a stage. Experiment `experiments` holds one flat row per method and seed,
with the parameters that the row depends on, and the whole composition as a file; rows of a study are nested in the run
of the study, which has its results. Logging does not change results, so no
stage depends on this file in dvc.yaml. If MLFLOW_TRACKING_URI is set, runs are logged to that server instead.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import subprocess
import time
import warnings
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

from talkingeyes.orchestration.mlflow_view import TAG, saved_view, shown_metrics

# Limits of one call of log_batch.
METRICS_PER_BATCH, PARAMS_PER_BATCH, PARAM_LENGTH = 900, 100, 6000
# Sections about the execution, which are not parameters of a row.
EXCLUDED_SECTIONS = {"machine", "workspace", "result_store", "target", "objective", "study"}
# Sections that only models depend on, unlike truth, fitted and mismatched motion.
MODEL_SECTIONS = {"pretrain", "train", "model", "validate", "sample"}
CORPUS_INDEX = "clips.parquet"
MLFLOW_PARENT = "mlflow.parentRunId"
REPOSITORY_ROOT = Path(__file__).resolve().parents[3]
MAX_LOGGING_S = 3600  # no run takes this long to be written


@dataclass(frozen=True)
class MethodResult:
    """One method in the flat comparison. Metrics are keyed split/part/metric."""

    name: str
    metrics: Mapping[str, float]
    artifacts: Sequence[Path] = ()


@dataclass(frozen=True)
class Report:
    """Results of a stage: its metrics and files, rows of the comparison of methods, and the history of a training.

    Rows of a history hold `step` and the metrics at that step; they become curves.
    """

    metrics: Mapping[str, float] = field(default_factory=dict)
    artifacts: Sequence[Path] = ()
    rows: Sequence[MethodResult] = ()
    history: Sequence[Mapping[str, float]] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class _Run:
    """Content of one MLflow run; `seconds` is the duration that it shows."""

    name: str
    params: Mapping[str, Any]
    metrics: Mapping[str, float]
    tags: Mapping[str, str]
    artifacts: Sequence[Path]
    history: Sequence[Mapping[str, float]] = ()
    seconds: float = 0.0


def log_run(
    root: Path,
    stage: str,
    name: str,
    params: Mapping[str, Any],
    sections_read: set[str],
    seconds: float,
    report: Report,
    overrides: Sequence[str] = (),
    data: Path | None = None,
) -> None:
    """Log one call of a stage with the sections that it used, and its rows, whose duration is that of their training.

    `overrides` are the Hydra overrides of the composition (key=value). `data` is the folder that the path of the corpus
    is relative to, if not `root`. A row that exists already is not repeated.
    """
    client, tags = _client(root), {"experiment": experiment_name(params, overrides), "revision": revision()}
    corpus = (data or root) / str(params.get("corpus"))
    if (corpus / CORPUS_INDEX).is_file():
        tags["corpus"] = corpus_name(corpus)
    flat = flatten(params)
    of_stage = {
        key: value for key, value in flat.items() if any(f"{key}.".startswith(f"{each}.") for each in sections_read)
    }
    metrics = {**report.metrics, "seconds": seconds}
    of_run = {"stage": stage, **tags}
    if stage == "train":
        of_run["training"] = _training_key(name.removeprefix("train-"), params)
    run = _Run(name, of_stage, metrics, of_run, report.artifacts, report.history, seconds)
    with exclusive(root):
        of_stages = get_experiment(client, root, "stages", {})
        _end_killed(client, of_stages)
        _log(client, of_stages, run)
        if not report.rows:
            return
        experiment = get_experiment(client, root, "experiments", {TAG: saved_view()})
        _end_killed(client, experiment)
        study = study_name(params, overrides)
        parent = {MLFLOW_PARENT: _study_run(client, experiment, study, tags)} if study else {}
        for row in report.rows:
            of_row = _run_of(row, params, tags, overrides)
            seconds = _training_seconds(client, of_stages, _training_key(row.name, params))
            of_row = replace(of_row, tags={**of_row.tags, **parent}, seconds=seconds)
            same = f"tags.key = '{of_row.tags['key']}' and attributes.status = 'FINISHED'"
            if not client.search_runs([experiment], same, max_results=1):
                client.log_text(_log(client, experiment, of_row), json.dumps(params, indent=1), "params.json")


def _training_key(method: str, params: Mapping[str, Any]) -> str:
    """A hash of what a training depends on, by which a row finds the run of its training."""
    own = method_parameters(method, params)
    of_training = {key: own[key] for key in own if key.split(".")[0] in ("model", "pretrain", "train")}
    content = json.dumps([method, params.get("corpus"), of_training], sort_keys=True, default=str)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _training_seconds(client: Any, stages: str, key: str) -> float:
    """Duration of the latest run of this training; 0 for a row without one."""
    found = client.search_runs([stages], f"tags.training = '{key}'", order_by=["start_time DESC"], max_results=1)
    return float(found[0].data.metrics["seconds"]) if found else 0.0


def log_study(root: Path, study: str, objective: Mapping[str, Any], report: Report) -> None:
    """Add objective, metrics and files to the run of a study, in which the rows of its trials are nested."""
    client = _client(root)
    with exclusive(root):
        experiment = get_experiment(client, root, "experiments", {TAG: saved_view()})
        run_id = _study_run(client, experiment, study, {"experiment": study, "revision": revision()})
        params = flatten({"objective": objective})
        _write(client, run_id, _Run(study, params, report.metrics, {}, report.artifacts))


def _study_run(client: Any, experiment: str, study: str, tags: Mapping[str, str]) -> str:
    """Id of the run of a study, which is made if it is missing."""
    quote = '"' if "'" in study else "'"  # a filter has no escapes
    found = client.search_runs([experiment], f"tags.study = {quote}{study}{quote}", max_results=1)
    if found:
        return str(found[0].info.run_id)
    return _log(client, experiment, _Run(study, {}, {}, {"study": study, **tags}, ()))


def flatten(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in node.items():
        nested = isinstance(value, Mapping)
        flat |= flatten(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat


def method_parameters(method: str, params: Mapping[str, Any], overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Parameters that the row of a method depends on.

    The sections of models are flat. Of models and tokenizers, only those of the method are included, under keys without
    their names, so that the same parameter of two models has the same column. Sections common to all models, and those
    that rarely vary, are included two levels deep, with the rest as JSON; an overridden key within it has a column of
    its own instead. What made a corpus is included for this corpus only: `synthesize` for that of the chain, `track`
    for all others.
    """
    shared = {key: value for key, value in params.items() if key not in EXCLUDED_SECTIONS | MODEL_SECTIONS}
    shared.pop("track" if params.get("corpus") == "data/synthesize" else "synthesize", None)
    everything = flatten(shared)
    flat = {key: everything[key] for key in _given(overrides) if key in everything}
    for key, value in _two_levels(shared):
        if isinstance(value, Mapping):
            flat[key] = json.dumps(_without_keys(value, f"{key}.", flat))
        else:
            flat[key] = value
    models = params.get("model", {})
    if method not in models:
        return flat
    own = {key: params[key] for key in ("train", "validate", "sample") if key in params}
    tokenizers = {tokenizer: params["pretrain"][tokenizer] for tokenizer in _tokenizers(models[method])}
    tokenizer = next(iter(tokenizers.values())) if len(tokenizers) == 1 else tokenizers
    return flat | flatten({**own, "model": models[method], "pretrain": tokenizer})


def corpus_name(folder: Path) -> str:
    """The name of a corpus and a hash of its index, which holds a hash of every clip: `synthesize 1f0a3c5e`."""
    return f"{folder.name} {hashlib.sha256((folder / CORPUS_INDEX).read_bytes()).hexdigest()[:8]}"


def run_name(method: str, params: Mapping[str, Any], experiment: str, overrides: Sequence[str]) -> str:
    """A readable name: the method, its seed, and the overrides or else the experiment."""
    if method not in params.get("model", {}):
        return method
    train, sample = (params.get(section, {}).get("seed", 0) for section in ("train", "sample"))
    seed = f"seed {train}" if train == sample else f"seed {train}, sampled {sample}"
    own = [f"model.{method}.", *(f"pretrain.{tokenizer}." for tokenizer in _tokenizers(params["model"][method]))]
    said = {"train.seed", "sample.seed", "sweep", "experiment", "hydra", *EXCLUDED_SECTIONS}
    short = []
    for key, value in _given(overrides).items():
        others = key.startswith(("model.", "pretrain.")) and not key.startswith(tuple(own))
        if key not in said and key.split(".")[0].split("/")[0] not in said and not others:
            short.append(f"{_without(key, own)}={value}")
    fallback = [experiment] if experiment != "default" else []
    return ", ".join([f"{method} {seed}", *(short or fallback)])


def experiment_name(params: Mapping[str, Any], overrides: Sequence[str]) -> str:
    """Name of the experiment of a run: that of `dvc exp run`, a study, a file of conf/experiment/, or `default`."""
    named = os.environ.get("DVC_EXP_NAME") or study_name(params, overrides) or _given(overrides).get("experiment")
    return str(named or "default")


def study_name(params: Mapping[str, Any], overrides: Sequence[str]) -> str | None:
    """Name of the study that a run belongs to, if it is one of a sweep."""
    return str(params.get("study", "default")) if {"sweep", "study"} & set(_given(overrides)) else None


def _run_of(row: MethodResult, params: Mapping[str, Any], tags: Mapping[str, str], overrides: Sequence[str]) -> _Run:
    """A row as a run. Its key is a hash of its content, so that an identical row is recognised."""
    own = method_parameters(row.name, params, overrides)
    content = json.dumps([row.name, tags["experiment"], own, dict(row.metrics)], sort_keys=True, default=str)
    splits = sorted({key.split("/")[0] for key in row.metrics if "/" in key})
    more = {"method": row.name, "split": ", ".join(splits), "key": hashlib.sha256(content.encode()).hexdigest()[:16]}
    if "train.seed" in own:
        more["seed"] = str(own["train.seed"])
    if overrides:
        more["overrides"] = " ".join(overrides)
    name = run_name(row.name, params, tags["experiment"], overrides)
    return _Run(name, own, {**row.metrics, **shown_metrics(row.metrics)}, {**tags, **more}, row.artifacts)


def _given(overrides: Sequence[str]) -> dict[str, str]:
    """Overrides (key=value, +key=value) by key."""
    return dict(each.lstrip("+").split("=", 1) for each in overrides if "=" in each)


def _two_levels(sections: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for section, node in sections.items():
        if isinstance(node, Mapping):
            yield from ((f"{section}.{key}", value) for key, value in node.items())
        else:
            yield section, node


def _without_keys(node: Mapping[str, Any], prefix: str, keys: Container[str]) -> dict[str, Any]:
    """A section without these dotted keys."""
    left = {}
    for key, value in node.items():
        if f"{prefix}{key}" not in keys:
            left[key] = _without_keys(value, f"{prefix}{key}.", keys) if isinstance(value, Mapping) else value
    return left


def _tokenizers(model: Mapping[str, Any]) -> list[str]:
    """The tokenizers that a model needs: a name, a list of names, or none."""
    tokenizer = model.get("tokenizer") or []
    return [tokenizer] if isinstance(tokenizer, str) else list(tokenizer)


def _without(key: str, prefixes: Sequence[str]) -> str:
    for prefix in prefixes:
        key = key.removeprefix(prefix)
    return key


def _client(root: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside MLflow and SQLAlchemy
        from mlflow.tracking import MlflowClient

        return MlflowClient(tracking_uri(root))


def tracking_uri(root: Path) -> str:
    """Where runs are logged: MLFLOW_TRACKING_URI, or mlflow.db, which is created if missing.

    One process creates the tables before anything is written, and the file appears atomically.
    """
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    if server := _server():
        return server
    path = root.resolve() / "mlflow.db"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from mlflow.store.db import utils

        with exclusive(root):
            if not path.exists():
                partial = path.with_name("mlflow.db.partial")
                partial.unlink(missing_ok=True)
                engine = utils.create_sqlalchemy_engine_with_retry(f"sqlite:///{partial}")
                utils._initialize_tables(engine)
                engine.dispose()
                partial.rename(path)
    return f"sqlite:///{path}"


def _server() -> str | None:
    return os.environ.get("MLFLOW_TRACKING_URI")


def exclusive(root: Path) -> AbstractContextManager[Any]:
    """Lock: one process at a time writes to mlflow.db, because SQLite times out under contention. A server needs no
    lock."""
    from filelock import FileLock

    return nullcontext() if _server() else FileLock(f"{root.resolve() / 'mlflow.db'}.lock")


def _log(client: Any, experiment: str, run: _Run) -> str:
    """Create a run, write it, and return its id."""
    end = int(1000 * time.time())
    start = end - int(1000 * run.seconds)
    run_id: str = client.create_run(experiment, start, dict(run.tags), run.name).info.run_id
    _write(client, run_id, run)
    client.set_terminated(run_id, end_time=end)
    return run_id


def _write(client: Any, run_id: str, run: _Run) -> None:
    from mlflow.entities import Metric, Param

    now = int(time.time() * 1000)
    points = [Metric(key, float(value), now, 0) for key, value in run.metrics.items()]
    points += [
        Metric(f"curve/{key}", float(value), now, int(row["step"]))
        for row in run.history
        for key, value in row.items()
        if key != "step"
    ]
    metrics = _batches(points, METRICS_PER_BATCH)
    params = _batches([Param(key, str(value)[:PARAM_LENGTH]) for key, value in run.params.items()], PARAMS_PER_BATCH)
    for some_metrics, some_params in zip_longest(metrics, params, fillvalue=()):
        client.log_batch(run_id, metrics=some_metrics, params=some_params)
    for path in run.artifacts:
        client.log_artifact(run_id, str(path))


def _end_killed(client: Any, experiment: str) -> None:
    """Mark runs of killed processes as KILLED.

    A run is written within the lock, so any unfinished one is of a killed process. A tracking server has no lock;
    there, only runs that are older than any logging takes count.
    """
    before = int(1000 * (time.time() - MAX_LOGGING_S)) if _server() else int(1000 * time.time()) + 1
    unfinished = f"attributes.status = 'RUNNING' and attributes.start_time < {before}"
    for run in client.search_runs([experiment], unfinished):
        client.set_terminated(run.info.run_id, "KILLED")


def get_experiment(client: Any, root: Path, name: str, tags: Mapping[str, str]) -> str:
    """The id of an experiment with these tags; its files are stored in mlartifacts/ beside the database."""
    from mlflow.exceptions import MlflowException

    place = None if _server() else (root.resolve() / "mlartifacts").as_uri()
    found = client.get_experiment_by_name(name)
    if found is None:
        with suppress(MlflowException):  # created by another process meanwhile
            client.create_experiment(name, artifact_location=place)
        found = client.get_experiment_by_name(name)
    for key, value in tags.items():
        if found.tags.get(key) != value:
            client.set_experiment_tag(found.experiment_id, key, value)
    return str(found.experiment_id)


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    remaining = iter(items)
    while batch := list(islice(remaining, size)):
        yield batch


def revision() -> str:
    """The git revision of the code; `none` outside a repository."""
    if not (REPOSITORY_ROOT / ".git").exists():
        return "none"
    described = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    found = subprocess.run(described, cwd=REPOSITORY_ROOT, capture_output=True, text=True, check=False)
    return found.stdout.strip() or "none"
