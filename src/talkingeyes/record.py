"""The record of what ran: MLflow in the workspace's mlflow.db, no server. `make ui` shows it.

Experiment `stages` holds one run a call of a stage, experiment `experiments` one flat row a method. Nothing here
changes a result, so no stage depends on this file in dvc.yaml.
"""

from __future__ import annotations

import logging
import subprocess
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

# What one call of log_batch takes at most.
METRICS_PER_BATCH, PARAMS_PER_BATCH, PARAM_LENGTH = 1000, 100, 6000


@dataclass(frozen=True)
class Row:
    """One method in the flat comparison. Metrics are keyed split/part/metric."""

    name: str
    metrics: Mapping[str, float]
    artifacts: Sequence[Path] = ()


@dataclass(frozen=True)
class Report:
    """What a stage reports: metrics and files of the stage, and rows of the comparison of methods."""

    metrics: Mapping[str, float] = field(default_factory=dict)
    artifacts: Sequence[Path] = ()
    rows: Sequence[Row] = ()


def record(
    root: Path, stage: str, name: str, params: Mapping[str, Any], used: set[str], seconds: float, report: Report
) -> None:
    """Log one call of a stage with the sections that it used, and its rows with the whole composition."""
    client = _client(root)
    flat = flatten(params)
    of_stage = {key: value for key, value in flat.items() if any(f"{key}.".startswith(f"{each}.") for each in used)}
    tags = {"stage": stage, "git_revision": _revision(root), **_seeds(flat)}
    metrics = {**report.metrics, "seconds": seconds}
    _log(client, root, "stages", Row(name, metrics, report.artifacts), of_stage, tags)
    for row in report.rows:
        _log(client, root, "experiments", row, flat, {**tags, "method": row.name})


def flatten(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in node.items():
        nested = isinstance(value, Mapping)
        flat |= flatten(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat


def _client(root: Path) -> Any:
    """A client of mlflow.db. The tables are made by one process before anything writes, and the file appears whole."""
    from filelock import FileLock

    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside MLflow and SQLAlchemy
        from mlflow.store.db import utils
        from mlflow.tracking import MlflowClient

        path = root.resolve() / "mlflow.db"
        with FileLock(f"{path}.lock"):
            if not path.exists():
                partial = path.with_name("mlflow.db.partial")
                partial.unlink(missing_ok=True)
                engine = utils.create_sqlalchemy_engine_with_retry(f"sqlite:///{partial}")
                utils._initialize_tables(engine)
                engine.dispose()
                partial.rename(path)
        return MlflowClient(f"sqlite:///{path}")


def _log(
    client: Any, root: Path, experiment: str, row: Row, params: Mapping[str, Any], tags: Mapping[str, str]
) -> None:
    from mlflow.entities import Metric, Param

    now = int(time.time() * 1000)
    run = client.create_run(_experiment(client, root, experiment), run_name=row.name, tags=dict(tags)).info.run_id
    for metrics in _batches([Metric(k, float(v), now, 0) for k, v in row.metrics.items()], METRICS_PER_BATCH):
        client.log_batch(run, metrics=metrics)
    for batch in _batches([Param(k, str(v)[:PARAM_LENGTH]) for k, v in params.items()], PARAMS_PER_BATCH):
        client.log_batch(run, params=batch)
    for path in row.artifacts:
        client.log_artifact(run, str(path))
    client.set_terminated(run)


def _experiment(client: Any, root: Path, name: str) -> str:
    """The id of an experiment; its files go to mlartifacts/ beside the database."""
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(name)
    if found is None:
        try:
            return str(client.create_experiment(name, artifact_location=(root.resolve() / "mlartifacts").as_uri()))
        except MlflowException:  # another process was first
            found = client.get_experiment_by_name(name)
    return str(found.experiment_id)


def _batches(items: list[Any], size: int) -> Iterator[list[Any]]:
    remaining = iter(items)
    while batch := list(islice(remaining, size)):
        yield batch


def _seeds(flat: Mapping[str, Any]) -> dict[str, str]:
    """The separate seeds of world, training and sampling, as tags to filter by."""
    return {key: str(value) for key, value in flat.items() if key.endswith(".seed")}


def _revision(root: Path) -> str:
    """The git revision that the code stands at, `none` outside a repository."""
    found = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=40"], cwd=root, capture_output=True, text=True, check=False
    )
    return found.stdout.strip() or "none"
