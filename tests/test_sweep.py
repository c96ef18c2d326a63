"""Sweeps: one-line errors; a study survives a kill and never repeats a trial; bad trials are pruned."""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import optuna
import pytest

import pipelines.experiment
import pipelines.pruned_sweep
from pipelines.optuna_study import prepare, storage
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose, quote_texts

# The old distribution names of Optuna, which Hydra's sweeper uses.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")

CODES = "pretrain.gaze_frames.network.quantiser.codes"
PLACES = "model.talkingeyes_events.gaze.process.absolute_components"


def run(monkeypatch, *arguments):
    """Run the command in this process."""
    monkeypatch.setattr(sys, "argv", ["experiment", *arguments])
    pipelines.experiment.main()


PATHS = ["a=b", "two words", "Jürgen", "動画", "a,b", "[x] (1)", "{a: 1}", "2024", "null", "a'b", 'a"b\\', "~#!&;%$x"]


def test_paths_with_any_characters_are_composed():
    for corpus, workspace, study, licence in zip(*[iter(PATHS)] * 4, strict=True):
        texts = [f"corpus=/data/{corpus}", f"workspace={workspace}", f"study={study}", f"track.licence={licence}"]
        params = compose(texts)
        found = params["corpus"], params["workspace"], params["study"], params["track"]["licence"]
        assert found == (f"/data/{corpus}", workspace, study, licence)
        assert params["result_store"] == f"{workspace}/store"
    assert quote_texts(["corpus='quoted for Hydra'"]) == ["corpus='quoted for Hydra'"]


def test_an_experiment_gets_a_path_with_any_characters(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(
        pipelines.experiment, "run_pipeline", lambda params, view, *_: seen.append((params, view)) or []
    )
    folder = tmp_path / "a=b, [c] Jürg's"
    run(monkeypatch, f"workspace={folder}", f"corpus={folder / 'x'}")
    ((params, view),) = seen
    assert (params["workspace"], params["corpus"], view) == (str(folder), str(folder / "x"), folder)


def test_in_a_sweep_several_values_are_a_path_only_if_it_exists(tmp_path):
    (tmp_path / "a,b").mkdir()
    overrides = [f"corpus={tmp_path}/a,{tmp_path}/b", f"corpus={tmp_path}/a,b", "corpus=c=d", "train.seed=0,1"]
    assert quote_texts(overrides, sweep=True) == [
        overrides[0],
        f"corpus='{tmp_path}/a,b'",
        "corpus='c=d'",
        overrides[3],
    ]


@pytest.mark.parametrize("name", PATHS)
def test_make_passes_a_path_with_any_characters(repository, name):
    command = ["make", "--no-print-directory", "-s", "--eval=shown: ; @printf %s $(call quoted,corpus)", "shown"]
    shown = subprocess.run([*command, f"corpus={name}"], cwd=repository, capture_output=True, text=True, check=True)
    assert shown.stdout == name


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["trian.seed=1"], "trian"),
        (["-m", "trian.seed=1,2"], "trian"),
        (["fit=nothing"], "nothing"),
        (["-m", "fit=default,nothing"], "nothing"),
        (["-m", f"{CODES}=64,0"], f"{CODES}: Input should be greater than 1, got 0"),
        (["-m", "sweep=nothing"], "nothing"),
        (["target=nothing"], "target: should be a stage or one of synthesize, fit"),
        (["objective.metrics=[diversity]"], "objective.metrics.0"),
        (["workspace=."], "workspace: should be another folder than the repository"),
        (
            ["-m", "sweep=free_running", "objective.metrics=[corr,dynamics_distance]"],
            "objective.metrics: should be one for each direction",
        ),
    ],
)
def test_a_mistake_is_one_line(repository, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(repository)
    workspace = [] if "workspace=." in arguments else [f"workspace={tmp_path}"]
    with pytest.raises(InputError) as error:
        run(monkeypatch, *arguments, *workspace)
    assert says in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "store").exists()


@pytest.mark.long
def test_a_mistake_in_a_sweep_is_status_2(repository, tmp_path):
    command = [sys.executable, "-m", "pipelines.experiment", "-m", "train.seed=0,x", f"workspace={tmp_path}"]
    result = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False, timeout=100)
    assert result.returncode == 2
    assert result.stderr.startswith("error: train.seed")
    assert result.stderr.count("\n") == 1


@pytest.mark.long
def test_an_error_inside_a_job_is_one_line(tmp_path, monkeypatch, capfd):
    def fail(*_):
        raise InputError("a clip is broken")

    monkeypatch.setattr(pipelines.experiment, "run_pipeline", fail)
    with pytest.raises(InputError, match=r"^a clip is broken$"):
        run(monkeypatch, "-m", "train.seed=0,1", "hydra/launcher=basic", f"workspace={tmp_path}")
    assert "Error executing" not in capfd.readouterr().err


@pytest.mark.long
def test_a_changed_search_space_is_refused(tmp_path):
    overrides = ["sweep=free_running", f"workspace={tmp_path}"]
    assert prepare(overrides).remaining_trials == 16
    with pytest.raises(
        InputError,
        match=rf"^study free_running: should have the same search as before, got changes of {PLACES}; .*study=NAME$",
    ):
        prepare([*overrides, f"{PLACES}=choice(16,32)"])
    assert (
        prepare([*overrides, f"{PLACES}=choice(16,32)", "study=other", "hydra.sweeper.n_trials=20"]).remaining_trials
        == 20
    )


def test_a_storage_may_be_a_database(tmp_path):
    overrides = [
        "sweep=free_running",
        f"workspace={tmp_path}",
        f"hydra.sweeper.storage.where=sqlite:///{tmp_path}/s.db",
    ]
    assert prepare(overrides).remaining_trials == 16
    assert (tmp_path / "s.db").exists()


# The command with a chain that only records its calls.
FAKE = """
import json, os, sys, time
from pathlib import Path
import pipelines.experiment as experiment

def chain(params, view, overrides=(), watch=None):
    codes = params["pretrain"]["gaze_frames"]["network"]["quantiser"]["codes"]
    weight = params["model"]["talkingeyes_paper"]["weights"]["head_kl"]
    with open(Path(params["workspace"], "asked"), "a") as file:
        print(json.dumps([os.getpid(), codes, weight]), file=file)
    time.sleep(0.3)
    return [codes / 100 + weight, weight]

experiment.run_pipeline = chain
experiment.main()
"""


@pytest.mark.long
def test_killed_sweep_resumes_without_repeats(repository, tmp_path):
    arguments = ["-m", "sweep=loss_weights", f"workspace={tmp_path}", "hydra/launcher=basic", "hydra.sweeper.n_jobs=1"]
    arguments.append("objective.seeds=[]")
    command = [sys.executable, "-c", FAKE, *arguments, "hydra.sweeper.n_trials=8"]
    asked = tmp_path / "asked"
    with subprocess.Popen(command, cwd=repository, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as first:
        deadline = time.monotonic() + 100
        while not asked.exists() or len(asked.read_text().splitlines()) < 3:
            assert first.poll() is None, first.stderr.read().decode()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        os.kill(first.pid, signal.SIGKILL)
    before = len(asked.read_text().splitlines())
    result = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False, timeout=100)
    assert result.returncode == 0, result.stderr
    lines = [tuple(json.loads(line)[1:]) for line in asked.read_text().splitlines()]
    assert len(set(lines)) == len(lines), "a trial was replayed"
    study = optuna.load_study(study_name="loss_weights", storage=storage(f"{tmp_path}/sweeps.journal"))
    states = [trial.state.name for trial in study.trials]
    assert states.count("COMPLETE") == 8
    assert states.count("FAIL") == 1  # the one that was killed
    assert len(lines) == 9 > before
    assert (tmp_path / "loss_weights/pareto.png").stat().st_size > 5000
    header, *importances = (tmp_path / "loss_weights/importances.csv").read_text().splitlines()
    assert header == "parameter,motion_distance,tie"
    shares = {line.split(",")[0].rsplit(".", 1)[1]: line.split(",")[1:] for line in importances}
    assert set(shares) == {"codes", "gaze_regularity", "gaze_velocity", "head_kl", "head_velocity"}
    assert float(shares["codes"][0]) > 0.5, "the first objective of FAKE is mostly the number of codes"
    assert "study loss_weights: 8 trials complete" in result.stdout
    assert prepare([*arguments[1:], "hydra.sweeper.n_trials=8"]).remaining_trials == 0


@pytest.mark.long
def test_bad_trials_end_early(tmp_path, monkeypatch):
    steps = []

    def chain(params, view, overrides, on_validation):
        weight = params["model"]["talkingeyes_events"]["weights"]["head_location"]
        for step in (1, 2, 3):
            steps.append(step)
            on_validation(step, {"validation_score": -weight})
        return [weight]

    monkeypatch.setattr(pipelines.pruned_sweep, "run_pipeline", chain)
    monkeypatch.setattr(
        sys,
        "argv",
        ["sweep", "sweep=free_running", f"workspace={tmp_path}", "machine.jobs=1", "hydra.sweeper.n_trials=9"],
    )
    pipelines.pruned_sweep.main()
    study = optuna.load_study(study_name="free_running", storage=storage(f"{tmp_path}/sweeps.journal"))
    states = [trial.state.name for trial in study.trials]
    assert len(states) == 9
    assert set(states) == {"COMPLETE", "PRUNED"}
    pruned = [trial for trial in study.trials if trial.state.name == "PRUNED"]
    assert len(steps) == 3 * states.count("COMPLETE") + sum(len(trial.user_attrs) for trial in pruned)
    worst = max(study.trials, key=lambda trial: trial.params["model.talkingeyes_events.weights.head_location"])
    assert study.best_value == min(
        trial.params["model.talkingeyes_events.weights.head_location"] for trial in study.trials
    )
    assert worst.number < 4 or worst.state.name == "PRUNED"


@pytest.mark.long
def test_trials_of_several_objectives_are_pruned_and_their_front_gets_further_seeds(tmp_path, monkeypatch):
    def chain(params, view, overrides, on_validation=lambda *_: None):
        weight = params["model"]["talkingeyes_paper"]["weights"]["head_kl"]
        on_validation(1, {"validation_score": -weight})
        return [weight + params["train"]["seed"], -weight]

    monkeypatch.setattr(pipelines.pruned_sweep, "run_pipeline", chain)
    argv = ["sweep", "sweep=loss_weights", f"workspace={tmp_path}", "machine.jobs=1", "hydra.sweeper.n_trials=12"]
    monkeypatch.setattr(sys, "argv", argv)
    pipelines.pruned_sweep.main()
    study = optuna.load_study(study_name="loss_weights", storage=storage(f"{tmp_path}/sweeps.journal"))
    states = {trial.number: trial.state.name for trial in study.trials}
    assert {*states.values()} == {"COMPLETE", "PRUNED"}
    assert [states[number] for number in range(4)] == ["COMPLETE"] * 4
    pruned = [trial.user_attrs["validation_score@1"] for trial in study.trials if trial.state.name == "PRUNED"]
    kept = [trial.user_attrs["validation_score@1"] for trial in study.trials if trial.state.name == "COMPLETE"]
    assert max(pruned) < max(kept)
    front = list(csv.DictReader((tmp_path / "loss_weights/front.csv").read_text().splitlines()))
    assert {int(row["trial"]) for row in front} == {trial.number for trial in study.best_trials}
    for row in front:
        assert row["seeds"] == "0 1 2"
        least, mean, greatest = (float(row[f"motion_distance_{of}"]) for of in ("min", "mean", "max"))
        assert (mean - least, greatest - mean) == pytest.approx((1, 1))
        assert row["tie_min"] == row["tie_max"]
