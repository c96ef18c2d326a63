"""MLflow with 1,000 rows: time to log a row, and to answer the queries of the comparison page.

Run: python -m benchmarks.mlflow_load [ROWS] The rows are random, of the size of real ones: the parameters of the
committed params.yaml, 57 metrics, no plots. The page requests 100 rows at once; the response contains every parameter,
metric and tag of them.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import yaml
from tqdm import tqdm

from talkingeyes.orchestration.mlflow_logging import MethodResult, Report, log_run
from talkingeyes.orchestration.mlflow_view import TEST_METRICS
from talkingeyes.orchestration.run import run_command

METRICS, REPEATS = 57, 5


def fill(root: Path, count: int) -> None:
    """Log a sweep over the seed, one row each."""
    params = yaml.safe_load(Path("params.yaml").read_text())
    rng = np.random.default_rng(0)
    keys = [*TEST_METRICS, *(f"unseen/gaze/figure_{index}" for index in range(METRICS - len(TEST_METRICS)))]
    for seed in tqdm(range(count), desc="rows", mininterval=2):
        composition = {**params, "train": {**params["train"], "seed": seed}}
        row = MethodResult("talkingeyes", dict(zip(keys, rng.random(len(keys)).tolist(), strict=True)))
        log_run(root, "experiment", f"job {seed}", composition, {"train"}, 0.0, Report(rows=[row]))


@contextmanager
def serving(root: Path) -> Iterator[tuple[str, int]]:
    """Start an MLflow server on a free port of 127.0.0.1; yield its address and process id."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", port, "--workers", "1"]
    command += ["--backend-store-uri", f"sqlite:///{root / 'mlflow.db'}"]
    process = subprocess.Popen(
        command,
        env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=5).close()
                break
            except OSError:
                time.sleep(0.2)
        yield f"http://127.0.0.1:{port}", process.pid
    finally:
        os.killpg(process.pid, 15)
        process.wait()


def asked(address: str, **query: Any) -> list[Any]:
    """Query the server for rows."""
    content = json.dumps({"experiment_ids": ["2"], **query}).encode()
    request = urllib.request.Request(
        f"{address}/api/2.0/mlflow/runs/search", content, {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=300) as answer:
        return list(json.load(answer).get("runs", []))


def cpu_seconds(server: int) -> float:
    """CPU seconds of a process and its children."""
    process = psutil.Process(server)
    times = [each.cpu_times() for each in (process, *process.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


def seconds(function: Callable[[], Any], server: int) -> tuple[float, float]:
    """Median wall-clock seconds and mean server CPU seconds of a call, after a warm-up."""
    function()
    found, before = [], cpu_seconds(server)
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        found.append(time.perf_counter() - start)
    return float(np.median(found)), (cpu_seconds(server) - before) / REPEATS


def main() -> None:
    """Fill the database, start the server, run the queries."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        fill(root, 1)  # creates the database
        start = time.process_time()
        fill(root, count)
        each = (time.process_time() - start) / count
        size = (root / "mlflow.db").stat().st_size / 1e6
        with serving(root) as (address, server):
            best = {"order_by": ["metrics.`test/gaze/corr` DESC"]}
            chosen = "tags.experiment = 'default' and metrics.`test/gaze/corr` > 0.5"
            rows = len(asked(address, max_results=10 * count))
            queries: list[tuple[str, dict[str, Any]]] = [
                ("the page: newest 100", {"max_results": 100}),
                ("the page: best 100 by a metric", {"max_results": 100, **best}),
                ("filter by tag and metric, best 100", {"max_results": 100, "filter": chosen, **best}),
                ("three of them", {"max_results": 3, **best}),
                ("all rows at once", {"max_results": count}),
            ]
            print(f"{rows} rows of {count} ({size:.0f} MB), {1000 * each:.0f} ms of CPU to log a row and its stage")
            print("\n| query | seconds | CPU seconds of the server |\n|---|---|---|")
            for name, query in queries:
                clock, cpu = seconds(partial(asked, address, **query), server)
                print(f"| {name} | {clock:.2f} | {cpu:.2f} |")


if __name__ == "__main__":
    run_command(main)
