"""All launchers run the real chain on the smallest corpus with the same results. They share one store."""

import csv
import json
import os
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from talkingeyes.orchestration.run import parallel_backend, parallel_map

pytestmark = pytest.mark.slow

CODES = "pretrain.gaze_frames.network.quantiser.codes"
SEARCHED = ("pretrain.gaze_frames", "model.talkingeyes_paper")
PAPER = "target=validate@talkingeyes_paper"


@pytest.fixture(scope="module")
def workspace(shared_folder):
    """One folder for all processes that run these tests, so that the store prevents repeated work."""
    return shared_folder / "launchers"


def sweep(repository, workspace, *arguments):
    """Run the command and return its output."""
    command = [sys.executable, "-m", "pipelines.experiment", "-m", "experiment=smoke_test", f"workspace={workspace}"]
    environment = {**os.environ, "HOME": str(workspace)}  # Ray stores a token there
    command += arguments
    result = subprocess.run(
        command, cwd=repository, capture_output=True, text=True, check=False, timeout=580, env=environment
    )
    assert result.returncode == 0, result.stderr[-4000:]
    return result.stdout + result.stderr


def validation_metrics(workspace, job):
    """Validation metrics of a job."""
    path = Path(workspace, "jobs", str(job), "data/validate/talkingeyes_paper/metrics.json")
    return json.loads(path.read_text())


def rows(workspace, key):
    """A logged parameter of all runs."""
    with sqlite3.connect(workspace / "mlflow.db") as database:
        query = (
            "select p.value from params p join runs r using (run_uuid) join experiments e using (experiment_id) "
            "where e.name = 'experiments' and p.key = ?"
        )
        return [value for (value,) in database.execute(query, [key])]


def test_four_codebook_sizes_share_all_but_pretrain_and_what_follows(repository, workspace):
    root = workspace / "basic"
    said = sweep(
        repository, root, f"result_store={workspace}/store", "hydra/launcher=basic", PAPER, f"{CODES}=32,48,64,96"
    )
    made = re.findall(r"^== (\S+)(?: \S+)?$", said, re.MULTILINE)
    for stage in ("pretrain", "train", "validate"):
        assert made.count(stage) == 4
    for stage in ("synthesize", "fit", "embed", "critic"):
        assert made.count(stage) <= 1
        assert len(re.findall(rf"^== {stage} is in the store$", said, re.MULTILINE)) >= 3
    assert sorted(rows(root, "pretrain.network.quantiser.codes"), key=int) == ["32", "48", "64", "96"]


def test_joblib_gives_what_basic_gives(repository, workspace):
    """Two workers need the same corpus at the same time: one makes it, with the output of a single process."""
    until = "target=train@talkingeyes_paper"
    sweep(repository, workspace / "basic", f"result_store={workspace}/store", "hydra/launcher=basic", until)
    said = sweep(repository, workspace / "joblib", until, "hydra/launcher=processes", "train.seed=0,1")
    assert re.findall(r"^== (?:synthesize|fit|embed)$", said, re.MULTILINE) == ["== synthesize", "== fit", "== embed"]
    both = [
        {path.parent.parent.name: path.read_text() for path in store.glob("*/output/SHA256SUMS")}
        for store in (workspace / "joblib/store", workspace / "store")
    ]
    same = both[0].keys() & both[1].keys()
    assert {name.rpartition("-")[0] for name in same} == {
        "synthesize",
        "fit",
        "embed",
        "pretrain-gaze_frames",
        "train-talkingeyes_paper",
    }
    assert all(both[0][name] == both[1][name] for name in same)


def test_optuna_and_ray_together(repository, workspace):
    root = workspace / "ray"
    short = [f"{each}.loop.{key}" for each in SEARCHED for key in ("steps=4", "batch=4", "validate_every=2")]
    sizes = "pretrain.gaze_frames.network.quantiser.codes=choice(32,64)"
    arguments = ["sweep=loss_weights", "hydra/launcher=ray_local", "hydra.sweeper.n_trials=2", sizes, *short]
    said = sweep(repository, root, f"result_store={workspace}/store", "objective.seeds=[1]", *arguments)
    assert "Ray Launcher is launching 2 jobs" in said
    assert "study loss_weights: 2 trials complete" in said
    with (root / "loss_weights/trials.csv").open() as file:
        trials = list(csv.DictReader(file))
    for number, trial in enumerate(trials):
        figures = validation_metrics(root, number)
        assert [float(trial[name]) for name in ("motion_distance", "tie")] == [
            figures["motion_distance"],
            figures["tie"],
        ]
    assert (root / "loss_weights/front.csv").exists()
    assert (root / "loss_weights/pareto.png").exists()


def squared(number):
    """Work of one worker."""
    return number * number, os.getpid()


def test_parallel_work_runs_on_ray(tmp_path):
    code = (
        "import os\nfrom test_launchers import squared\n"
        "from talkingeyes.orchestration.run import parallel_backend, parallel_map\n"
        "with parallel_backend({'backend': 'ray', 'ray_address': None, 'jobs': 2}):\n"
        "    found = list(parallel_map(squared, range(20), 2, 'squares'))\n"
        "assert [square for square, _ in found] == [n * n for n in range(20)]\n"
        "assert os.getpid() not in {process for _, process in found}\n"
    )
    environment = {**os.environ, "HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=200)


def test_inside_a_worker_clips_go_one_after_another():
    (processes,) = parallel_map(_nested, [4], 2, "outer")
    assert len(processes) == 1


def _nested(count):
    with parallel_backend({}):
        return {process for _, process in parallel_map(squared, range(count), 2, "inner")}
