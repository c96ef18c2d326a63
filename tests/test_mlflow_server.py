"""The MLflow server on 127.0.0.1: eight processes sweep and log at once; REST and a browser read the runs."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from browser import CHROMIUM, open_browser
from toy_config import PARAMS

from talkingeyes.orchestration.mlflow_logging import MethodResult, Report, log_run
from talkingeyes.orchestration.mlflow_view import TAG, TEST_METRICS, main, page
from talkingeyes.rendering.video import write_video

PROCESSES, TRIALS = 8, 2
WRITER = """
import sys
from pathlib import Path
import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from toy_config import PARAMS
from talkingeyes.orchestration.mlflow_view import TEST_METRICS
from talkingeyes.orchestration.mlflow_logging import MethodResult, Report, log_run

optuna.logging.set_verbosity(optuna.logging.WARNING)
root = Path(sys.argv[1])
storage = JournalStorage(JournalFileBackend(str(root / "journal.log")))
study = optuna.create_study(study_name="alive", storage=storage, load_if_exists=True)
for _ in range(int(sys.argv[2])):
    trial = study.ask()
    seed = trial.number
    params = {**PARAMS, "train": {"seed": seed}, "sample": {"seed": seed}}
    metrics = {metric: 0.2 + seed / 100 + index / 10 for index, metric in enumerate(TEST_METRICS)}
    rows = [MethodResult(method, metrics) for method in ("vae", "talkingeyes")]
    overrides = ["sweep=free_running", f"train.seed={seed}", f"sample.seed={seed}"]
    log_run(root, "experiment", f"trial {seed}", params, {"train"}, 0.1, Report(rows=rows), overrides)
    study.tell(trial, trial.suggest_float("x", 0, 1))
"""


@dataclass(frozen=True)
class Server:
    """A running MLflow server."""

    address: str

    def post(self, call, **content):
        """Response of the REST interface."""
        request = urllib.request.Request(
            f"{self.address}/api/2.0/mlflow/{call}",
            data=json.dumps(content).encode(),
            headers={"Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)

    def experiment(self, name):
        with urllib.request.urlopen(
            f"{self.address}/api/2.0/mlflow/experiments/get-by-name?experiment_name={name}", timeout=60
        ) as answer:
            return json.load(answer)["experiment"]

    def rows(self, **query):
        return self.post("runs/search", experiment_ids=[self.experiment("experiments")["experiment_id"]], **query)[
            "runs"
        ]


@pytest.fixture(scope="module")
def root(tmp_path_factory, repository):
    """A workspace in which eight processes have worked on one study, starting without a database."""
    root = tmp_path_factory.mktemp("recorded")
    apart = {key: value for key, value in os.environ.items() if key not in ("DVC_EXP_NAME", "MLFLOW_TRACKING_URI")}
    command = [sys.executable, "-c", WRITER, str(root), str(TRIALS)]
    writers = [subprocess.Popen(command, cwd=repository / "tests", env=apart) for _ in range(PROCESSES)]
    assert [writer.wait(timeout=240) for writer in writers] == [0] * PROCESSES
    return root


@contextmanager
def serving(root):
    """`mlflow server`, as started by `make ui`, on a free port of 127.0.0.1; stopped at the end."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port), "--workers", "1"]
    command += ["--backend-store-uri", f"sqlite:///{root / 'mlflow.db'}"]
    command += ["--artifacts-destination", str(root / "mlartifacts")]
    process = subprocess.Popen(
        command,
        env={**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(240):
            try:
                with urllib.request.urlopen(f"{address}/health", timeout=5):
                    break
            except OSError:
                assert process.poll() is None, "the server has ended"
                time.sleep(0.25)
        yield Server(address)
    finally:
        os.killpg(process.pid, 15)
        process.wait(timeout=60)


@pytest.fixture(scope="module")
def server(root):
    with serving(root) as running:
        yield running


@pytest.mark.long
def test_eight_processes_lose_nothing(server):
    stages = server.post("runs/search", experiment_ids=[server.experiment("stages")["experiment_id"]])["runs"]
    assert sorted(run["info"]["run_name"] for run in stages) == sorted(f"trial {n}" for n in range(PROCESSES * TRIALS))
    studies = [run for run in server.rows() if run["info"]["run_name"] == "alive"]
    assert len(studies) == 1, "the run of the study, which holds the trials"
    rows = [run for run in server.rows() if run not in studies]
    names = [f"{method} seed {seed}, alive" for method in ("vae", "talkingeyes") for seed in range(PROCESSES * TRIALS)]
    assert sorted(row["info"]["run_name"] for row in rows) == sorted(names)
    assert all(len(row["data"]["metrics"]) == len(TEST_METRICS) for row in rows)
    assert {row["info"]["status"] for row in [*studies, *rows]} == {"FINISHED"}


@pytest.mark.long
def test_three_runs_are_compared_through_rest(server):
    best = server.rows(
        filter="tags.method = 'vae' and params.`model.width` = '64' and metrics.`corr. eyes` > 0.2",
        order_by=["metrics.`corr. eyes` DESC"],
        max_results=3,
    )
    assert [row["info"]["run_name"] for row in best] == [f"vae seed {seed}, alive" for seed in (15, 14, 13)]
    tags = {tag["key"]: tag["value"] for tag in best[0]["data"]["tags"]}
    assert (tags["experiment"], tags["seed"]) == ("alive", "15")
    assert tags["revision"]
    assert tags["overrides"] == "sweep=free_running train.seed=15 sample.seed=15"
    params = [{each["key"]: each["value"] for each in row["data"]["params"]} for row in best]
    differing = {key for key in params[0] if len({each[key] for each in params}) > 1}
    assert differing == {"train.seed", "sample.seed"}
    view = next(tag["value"] for tag in server.experiment("experiments")["tags"] if tag["key"] == TAG)
    columns = json.loads(json.loads(view)["state"])["selectedColumns"]
    assert set(TEST_METRICS) <= {column.split("`")[1] for column in columns}


def test_make_ui_prints_where_the_comparison_is(root, tmp_path, capsys):
    assert main([str(root), "127.0.0.1:5000"]) == 0
    table, chart = capsys.readouterr().out.splitlines()
    assert "http://127.0.0.1:5000/#/experiments/2/runs?" in chart
    assert "compareRunsMode=TABLE" in table
    assert main([str(tmp_path), "127.0.0.1:5000"]) == 2
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / 'mlflow.db'}: should hold rows")


@pytest.mark.long
def test_a_server_can_take_the_place_of_the_file(server, tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", server.address)
    log_run(
        tmp_path,
        "stage",
        "told",
        {"fit": {"x": 1}},
        {"fit"},
        0.1,
        Report(rows=[MethodResult("told", {"test/a/b": 1.0})]),
    )
    assert list(tmp_path.iterdir()) == []
    assert [row["info"]["run_name"] for row in server.rows(filter="tags.method = 'told'")] == ["told"]


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
@pytest.mark.parametrize("mode", ["CHART", "TABLE"])
def test_the_comparison_page_shows_figures_without_choosing_columns(server, tmp_path, mode):
    address = server.address + page(server.experiment("experiments")["experiment_id"], mode)
    with open_browser(tmp_path, 1800, 2000) as browser:
        browser.open(address)
        browser.wait_for("document.body.innerText.includes('vae seed 7, alive')")
        shown = "Differences" if mode == "CHART" else "test/gaze/tie_ratio"
        browser.wait_for(f"document.body.innerText.includes('{shown}')")
        text = browser.value("document.body.innerText")
    assert "Error loading shared view state" not in text
    if mode == "TABLE":  # the best first
        assert text.index("vae seed 7, alive") < text.index("vae seed 0, alive")


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_the_film_of_a_row_can_be_played(server, root, tmp_path):
    film = tmp_path / "vae.mp4"
    frames = np.random.default_rng(0).integers(0, 255, (25, 32, 32, 3)).astype(np.uint8)
    write_video(film, frames, 25.0, np.zeros(16_000, np.float32))
    row = MethodResult("vae", {"test/gaze/l2": 9.0}, [film])
    log_run(root, "report", "report", PARAMS, {"train"}, 0.1, Report(rows=[row]))
    (run,) = (row["info"]["run_id"] for row in server.rows(filter="metrics.`test/gaze/l2` = 9"))
    experiment = server.experiment("experiments")["experiment_id"]
    with open_browser(tmp_path / "profile") as browser:
        browser.open(f"{server.address}/#/experiments/{experiment}/runs/{run}/artifacts/vae.mp4")
        assert browser.wait_for("document.querySelector('video')?.duration") == pytest.approx(1.0, abs=0.1)
