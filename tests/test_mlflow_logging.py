"""Logging to MLflow: names, relevant parameters, the saved view."""

from __future__ import annotations

import hashlib
import json

import pytest
from toy_config import PARAMS, mlflow_client

from talkingeyes.evaluation.measures.corr import CRITICS
from talkingeyes.orchestration.mlflow_logging import (
    MethodResult,
    Report,
    experiment_name,
    flatten,
    log_run,
    log_study,
    method_parameters,
    run_name,
)
from talkingeyes.orchestration.mlflow_view import TAG, TEST_METRICS, VAL_METRICS, page, saved_view


@pytest.fixture
def recorded_root(tmp_path, monkeypatch):
    monkeypatch.delenv("DVC_EXP_NAME", raising=False)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return tmp_path


def test_flatten_joins_keys():
    assert flatten({"a": {"b": 1, "c": {"d": [2]}}, "e": None}) == {"a.b": 1, "a.c.d": [2], "e": None}


def test_a_row_has_the_parameters_that_it_depends_on():
    shared = {"corpus": "data/synthesize", "synthesize.seed": 0, "fit.tolerance": 0.1}
    assert method_parameters("truth", PARAMS) == {**shared, "fit.smoothing": '{"step_cost": 30.0}'}
    overridden = method_parameters("truth", PARAMS, ["fit.smoothing.step_cost=30.0", "model.vae.width=64", "fit=adam"])
    assert overridden["fit.smoothing.step_cost"] == 30.0
    assert overridden["fit.smoothing"] == "{}"  # no parameter says the same as another
    assert "model.vae.width" not in overridden
    own = method_parameters("vae", PARAMS)
    assert {key: value for key, value in own.items() if key.startswith(("model", "pretrain"))} == {
        "model.kind": "speech_to_motion",
        "model.tokenizer": None,
        "model.width": 64,
    }
    assert own["train.seed"] == 1
    assert own["sample.seed"] == 1
    assert not any(
        key.startswith(("machine", "workspace", "result_store", "target", "objective", "study")) for key in own
    )
    with_prior = method_parameters("talkingeyes", PARAMS)
    assert with_prior["pretrain.codes"] == 256
    assert with_prior["model.weights.head_kl"] == 1.0


def test_only_what_made_the_corpus_is_logged():
    tracked = {**PARAMS, "corpus": "elsewhere", "track": {"fps": 25.0}}
    of_elsewhere = method_parameters("truth", tracked)
    assert "synthesize.seed" not in of_elsewhere
    assert of_elsewhere["track.fps"] == 25.0
    assert "track.fps" not in method_parameters("truth", {**tracked, "corpus": PARAMS["corpus"]})


@pytest.mark.parametrize(
    ("method", "overrides", "name"),
    [
        ("truth", ["train.seed=1"], "truth"),
        ("vae", [], "vae seed 1"),
        ("vae", ["train.seed=1", "sample.seed=1", "workspace=x", "hydra/launcher=basic"], "vae seed 1"),
        ("vae", ["model.vae.width=64", "model.talkingeyes.weights.head_kl=1"], "vae seed 1, width=64"),
        (
            "talkingeyes",
            ["+model.talkingeyes.weights.head_kl=1", "pretrain.gaze_patches.codes=256", "fit=adam"],
            "talkingeyes seed 1, weights.head_kl=1, codes=256, fit=adam",
        ),
    ],
)
def test_runs_have_readable_names(method, overrides, name):
    assert run_name(method, PARAMS, "default", overrides) == name


def test_run_name_has_sampling_seed_and_experiment():
    params = {**PARAMS, "sample": {"seed": 2}}
    assert run_name("vae", params, "calm", []) == "vae seed 1, sampled 2, calm"


def test_an_experiment_is_a_study_a_delta_or_dvcs_own(monkeypatch):
    monkeypatch.delenv("DVC_EXP_NAME", raising=False)
    assert experiment_name(PARAMS, []) == "default"
    assert experiment_name(PARAMS, ["experiment=tiny"]) == "tiny"
    assert experiment_name(PARAMS, ["experiment=tiny", "sweep=free_running"]) == "alive"
    monkeypatch.setenv("DVC_EXP_NAME", "calm")
    assert experiment_name(PARAMS, ["experiment=tiny"]) == "calm"


def test_a_study_may_have_an_apostrophe(recorded_root):
    for count in (1.0, 2.0):
        log_study(recorded_root, "ann's", {"model": "vae"}, Report({"trials_complete": count}))
    client = mlflow_client(recorded_root)
    (study,) = client.search_runs([client.get_experiment_by_name("experiments").experiment_id])
    assert study.data.metrics == {"trials_complete": 2.0}


def test_rows_of_a_study_are_nested_in_its_run(tmp_path, recorded_root):
    front = tmp_path / "pareto.png"
    front.write_bytes(b"png")
    for weight in (0.1, 0.2):
        row = Report(rows=[MethodResult("vae", {"val/corr": weight})])
        log_run(
            recorded_root, "experiment", "alive", PARAMS, set(), 0.0, row, ["sweep=free_running", f"weight={weight}"]
        )
    log_study(recorded_root, "alive", {"model": "vae"}, Report({"trials_complete": 2.0}, [front]))
    client = mlflow_client(recorded_root)
    runs = client.search_runs([client.get_experiment_by_name("experiments").experiment_id])
    (study,) = (run for run in runs if run.info.run_name == "alive")
    assert study.data.metrics == {"trials_complete": 2.0}
    assert study.data.params == {"objective.model": "vae"}
    assert study.info.status == "FINISHED"
    assert [file.path for file in client.list_artifacts(study.info.run_id)] == ["pareto.png"]
    trials = [run for run in runs if run is not study]
    assert len(trials) == 2
    assert all(run.data.tags["mlflow.parentRunId"] == study.info.run_id for run in trials)


def test_row_is_logged_once_with_plot_and_configuration(tmp_path, recorded_root):
    plot = tmp_path / "plot.png"
    plot.write_bytes(b"png")
    index = recorded_root / "data" / "synthesize" / "clips.parquet"
    index.parent.mkdir(parents=True)
    index.write_bytes(b"index")
    of_vae = MethodResult("vae", {"test/gaze/l2": 0.25, "val/corr": 0.5, "requirements_ties": 1.0}, [plot])
    report = Report({"error": 0.5}, [plot], [of_vae, MethodResult("truth", {})])
    for _ in range(2):
        log_run(recorded_root, "report", "report", PARAMS, {"fit"}, 1.5, report, ["train.seed=1"])
    client = mlflow_client(recorded_root)
    stages, rows = (client.get_experiment_by_name(name) for name in ("stages", "experiments"))
    runs = client.search_runs([stages.experiment_id])
    assert [run.info.run_name for run in runs] == ["report", "report"]
    assert runs[0].data.params == {
        "fit.tolerance": "0.1",
        "fit.smoothing.step_cost": "30.0",
    }  # the run of a stage has the sections that it read
    assert runs[0].data.metrics == {"error": 0.5, "seconds": 1.5}
    vae, truth = sorted(client.search_runs([rows.experiment_id]), key=lambda run: run.info.run_name, reverse=True)
    assert (vae.info.run_name, truth.info.run_name) == ("vae seed 1", "truth")
    assert vae.info.status == "FINISHED"
    corpus = f"synthesize {hashlib.sha256(b'index').hexdigest()[:8]}"
    expected = {"experiment": "default", "seed": "1", "method": "vae", "split": "test, val", "corpus": corpus}
    assert vae.data.tags.items() >= expected.items()
    assert "seed" not in truth.data.tags
    assert vae.data.tags["revision"]
    assert {file.path for file in client.list_artifacts(vae.info.run_id)} == {"plot.png", "params.json"}
    view = json.loads(json.loads(rows.tags[TAG])["state"])
    assert "metrics.`corr. eyes`" in view["selectedColumns"]
    assert vae.data.metrics["ties"] == 1.0


def test_a_row_lasts_as_long_as_its_training(recorded_root):
    log_run(recorded_root, "train", "train-vae", PARAMS, {"train"}, 90.0, Report())
    log_run(recorded_root, "train", "train-vae", {**PARAMS, "train": {"seed": 7}}, {"train"}, 30.0, Report())
    log_run(
        recorded_root,
        "report",
        "report",
        PARAMS,
        set(),
        1.0,
        Report(rows=[MethodResult("vae", {}), MethodResult("truth", {})]),
    )
    client = mlflow_client(recorded_root)
    runs = client.search_runs([client.get_experiment_by_name("experiments").experiment_id])
    assert {run.data.tags["method"]: run.info.end_time - run.info.start_time for run in runs} == {
        "vae": 90_000,
        "truth": 0,
    }


def test_the_view_opens_on_test_and_val_with_the_tie_to_the_sound():
    figures = {"diversity_ratio", "corr", "tie_ratio", "speed_ratio", "still_fraction"}
    assert all(len(short) <= 12 for short in TEST_METRICS)  # a column's width
    long = [*TEST_METRICS.values()]
    assert long[:3] == ["requirements_ties", "requirements_margins", "requirements_learnt"]
    for metric in long[3:]:
        split, part, figure = metric.split("/")
        assert split == "test"
        assert part in CRITICS
        assert figure in figures
    assert {"test/gaze/tie_ratio", "test/head/tie_ratio"} <= set(long)
    assert all(metric.startswith("val/") for metric in VAL_METRICS)
    state = json.loads(json.loads(saved_view())["state"])
    assert state["orderByKey"] in state["selectedColumns"]
    assert not state["orderByAsc"]
    assert "compareRunsMode=TABLE" in page("2")
