"""Overhead of a sweep trial besides its stages, and scaling of the store and MLflow to a thousand tiny results.

Run     python -m benchmarks.sweep [ROWS]     (make bench; a thousand rows by default)
Writes  a table to stdout; nothing else remains
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipelines.experiment import stage_order
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.mlflow_logging import log_run
from talkingeyes.orchestration.result_store import StoredResult, get_or_run
from talkingeyes.orchestration.run import MethodResult, Report, Workspace, run_command
from talkingeyes.orchestration.stage_graph import StageCall, required_calls, stage_calls


def make(call: StageCall, workspace: Workspace) -> Report:
    """A stage that writes one small file."""
    with workspace.output(*call.folder.parts[1:]) as folder:
        (folder / "metrics.json").write_text("{}")
    return Report({"one": 1.0})


def chain(store: Path, params: dict[str, Any], stages: list[StageCall]) -> None:
    """Run all stages of a trial."""
    entries: dict[Path, StoredResult] = {}
    for call in stages:
        entries[call.folder] = get_or_run(store, call, params, entries, make)


def timed(title: str, work: Callable[[], None], count: int) -> None:
    """Print CPU and wall-clock seconds per item."""
    cpu, clock = time.process_time(), time.perf_counter()
    work()
    cpu, clock = time.process_time() - cpu, time.perf_counter() - clock
    print(f"| {title} | {count} | {cpu / count:.4f} | {clock / count:.4f} |", flush=True)


def main() -> None:
    """Compose, look up, store, log; then query all rows."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print("| operation | count | CPU s each | wall-clock s each |\n|---|---|---|---|")
    timed("the first composition, with its imports", lambda: _compose(1), 1)
    timed("a composition", lambda: _compose(5), 5)
    params = compose(["target=validate@talkingeyes_events"])
    stages = required_calls(stage_calls(params, stage_order(params)), params["target"])
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder, "store")
        timed("a trial that runs all (tiny) stages", lambda: chain(store, params, stages), 1)
        timed("a trial with all stages in the store", lambda: _again(store, params, stages), 20)
        timed("writing a tiny result to the store", lambda: _results(store, params, stages[0], rows), rows)
        timed("reading a tiny result from a full store", lambda: _results(store, params, stages[0], rows), rows)
        timed("the first row in MLflow, with imports and tables", lambda: _rows(Path(folder), params, 1), 1)
        timed("a row in MLflow", lambda: _rows(Path(folder), params, rows, 1), rows)
        timed("all rows of the comparison, in one query", lambda: _ask(Path(folder), rows + 1), 1)


def _compose(times: int) -> None:
    for _ in range(times):
        compose(["target=validate@talkingeyes_events"])


def _again(store: Path, params: dict[str, Any], stages: list[StageCall]) -> None:
    for _ in range(20):
        chain(store, params, stages)


def _results(store: Path, params: dict[str, Any], call: StageCall, count: int) -> None:
    for seed in range(1, count + 1):
        get_or_run(store, call, {**params, "synthesize": {**params["synthesize"], "seed": seed}}, {}, make)


def _rows(root: Path, params: dict[str, Any], count: int, start: int = 0) -> None:
    for seed in range(start, start + count):
        trial = {**params, "train": {**params["train"], "seed": seed}}
        figures = {f"val/figure_{number}": seed + number / 10 for number in range(9)}
        log_run(
            root,
            "experiment",
            "trial",
            trial,
            {"train"},
            1.0,
            Report(rows=[MethodResult("talkingeyes_events", figures)]),
        )


def _ask(root: Path, expected: int) -> None:
    from mlflow.tracking import MlflowClient

    client = MlflowClient(f"sqlite:///{root}/mlflow.db")
    experiment = client.get_experiment_by_name("experiments").experiment_id
    found = client.search_runs([experiment], order_by=["metrics.`val/figure_0` DESC"], max_results=5000)
    if len(found) != expected:
        raise RuntimeError(f"{expected} rows were logged, {len(found)} found")


if __name__ == "__main__":
    run_command(main)
