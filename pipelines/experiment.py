"""Hydra entry point: compose conf/ and run the pipeline through the result store, once or for every job of a sweep.

One run    python -m pipelines.experiment [overrides]          e.g. experiment=tiny, train.seed=1, target=train@vae A
sweep    python -m pipelines.experiment -m train.seed=0,1,2  or sweep=loss_weights (docs/sweeps.md)

Any key and any group can be swept. Every job calls the same stage functions as dvc.yaml, in the same order, and reuses
results of the store or data/. Results appear as links in the folder that `workspace` names, the row in MLflow there. A
job returns the metrics of `objective`, measured on val.
"""

import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import (
    CONFIG_DIR,
    one_line_hydra_errors,
    quote_texts,
    validate_config,
    write_params,
)
from talkingeyes.orchestration.mlflow_logging import log_run
from talkingeyes.orchestration.result_store import StoredResult, get_or_run, link_output
from talkingeyes.orchestration.run import MethodResult, Report, Workspace, parallel_backend, run_command
from talkingeyes.orchestration.stage_graph import (
    DEFAULT_CORPUS,
    REPOSITORY_ROOT,
    StageCall,
    required_calls,
    stage_calls,
)

REFERENCES = ("truth", "fitted", "mismatched")
GAZE_WITH_LIKELIHOOD = ("point_process", "categorical")
ValidationCallback = Callable[[int, dict[str, float]], None]


def stage_order(params: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """The stages in order, each with its item, if any."""
    models = list(params["model"])
    watched = [name for name, model in params["model"].items() if "gaze" in model["parts"]]
    scored = [name for name in watched if params["model"][name].get("gaze", {}).get("kind") in GAZE_WITH_LIKELIHOOD]
    judged = [name for name, model in params["model"].items() if {"gaze", "face"} & set(model["parts"])]
    yield from (("synthesize",), ("fit",), ("embed",))
    yield from (("pretrain", tokenizer) for tokenizer in params["pretrain"])
    yield from (("train", model) for model in models)
    yield ("critic",)
    yield from (("validate", row) for row in (*REFERENCES, *watched))
    yield from (("information", model) for model in scored)
    yield from (("sample", model) for model in judged)
    yield from (("evaluate", row) for row in (*REFERENCES, *judged))
    yield ("report",)


def pipeline_calls(params: Mapping[str, Any]) -> list[StageCall]:
    """The calls that `target` depends on. An external corpus replaces `synthesize`."""
    found = stage_calls(params, stage_order(params))
    if params["corpus"] != DEFAULT_CORPUS:
        found = [call for call in found if call.stage != "synthesize"]
    return required_calls(found, params["target"])


def run_pipeline(
    params: Mapping[str, Any],
    view: Path,
    overrides: Sequence[str] = (),
    on_validation: ValidationCallback | None = None,
) -> list[float]:
    """Run what is not in the store, link all into `view`, and log the rows. Returns the objectives, if they were
    measured."""
    root, start = Path(params["workspace"]), time.monotonic()
    if root.resolve() == REPOSITORY_ROOT or view.resolve() == REPOSITORY_ROOT:
        raise InputError("workspace: should be another folder than the repository, whose data/ belongs to dvc")
    if params["corpus"] != DEFAULT_CORPUS:
        params = {**params, "corpus": str(Path(params["corpus"]).resolve())}
    write_params(view / "params.yaml", dict(params))
    entries: dict[Path, StoredResult] = {}

    def make(call: StageCall, workspace: Workspace) -> Report:
        print("==", call.stage, *call.names, file=sys.stderr)
        return _stage(call, replace(workspace, on_validation=on_validation), root, view, params)

    for call in pipeline_calls(params):
        entry = get_or_run(Path(params["result_store"]), call, params, entries, make)
        if entry.origin != "made":
            print("==", call.stage, *call.names, f"reused from {entry.origin}", file=sys.stderr)
        entries[call.folder] = entry
        link_output(entry, view / call.folder)
    return _log(params, entries, root, view, overrides, time.monotonic() - start)


def _stage(call: StageCall, workspace: Workspace, root: Path, view: Path, params: Mapping[str, Any]) -> Report:
    """Call a stage and log it; its rows are logged later with those of the whole pipeline."""
    stage = importlib.import_module(f"pipelines.{call.stage}").run
    start = time.monotonic()
    with parallel_backend(params["machine"]):
        report: Report = stage(workspace, *call.names)
    seconds = time.monotonic() - start
    title = "-".join([call.stage, *call.names])
    log_run(root, call.stage, title, params, workspace.sections_read, seconds, replace(report, rows=()), data=view)
    return report


def _log(
    params: Mapping[str, Any],
    entries: Mapping[Path, StoredResult],
    root: Path,
    view: Path,
    overrides: Sequence[str],
    seconds: float,
) -> list[float]:
    """Log one flat row per model: its row of the report, if there is one, and its metrics on val."""
    val = {
        folder.name: json.loads((entry.output / "metrics.json").read_text())
        for folder, entry in entries.items()
        if folder.parts[1] == "validate"
    }
    rows = {row.name: row for entry in entries.values() for row in entry.report.rows}
    for model, figures in val.items():
        row = rows.get(model, MethodResult(model, {}))
        rows[model] = replace(row, metrics={**row.metrics, **{f"val/{key}": value for key, value in figures.items()}})
    objective = params["objective"]
    measured = val.get(objective["model"], {})
    if missing := [key for key in objective["metrics"] if measured and key not in measured]:
        raise InputError(f"objective.metrics: {objective['model']} has no {missing[0]}")
    wanted = {key: measured[key] for key in objective["metrics"]} if measured else {}
    report = Report(metrics=wanted, rows=list(rows.values()))
    log_run(root, "experiment", params["study"], params, set(params), seconds, report, overrides, view)
    return list(wanted.values())


def job(config: Any) -> float | tuple[float, ...] | None:
    """One job, called by Hydra."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    hydra_config = HydraConfig.get()
    params = validate_config(OmegaConf.to_container(config, resolve=True))
    if params["machine"]["device"] != "cpu":
        from talkingeyes.training.execution import ExecutionContext

        ExecutionContext.of(params["machine"])  # report a missing GPU before the corpus is made
    found = run_pipeline(params, Path(hydra_config.runtime.output_dir), list(hydra_config.overrides.task))
    return found[0] if len(found) == 1 else tuple(found) or None


def main() -> None:
    """Validate the arguments, run Hydra, and write the results of a study."""
    from pipelines.optuna_study import prepare, silence_warnings, write_results

    silence_warnings()
    is_sweep = bool({"-m", "--multirun"} & set(sys.argv[1:]))
    arguments = quote_texts(sys.argv[1:], sweep=is_sweep)
    overrides = [each for each in arguments if not each.startswith("-")]
    if not is_sweep:
        return run_hydra(arguments)
    study = prepare(overrides)
    if study is None:
        return run_hydra(arguments)
    with study.exclusive():
        if study.remaining_trials:
            run_hydra([*arguments, *study.overrides()])
        write_results(study, run_pipeline)


def run_hydra(arguments: list[str]) -> None:
    """Run Hydra with these arguments; its errors become one line."""
    from hydra import main as entry

    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors are raised, not printed
    sys.argv[1:] = arguments
    with one_line_hydra_errors(), redirect_stderr(_WithoutEcho(sys.stderr)):
        entry(config_path=str(CONFIG_DIR), config_name="config", version_base="1.3")(job)()


class _WithoutEcho:
    """stderr without the line that Hydra prints before it raises the error of a job."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return 0 if text.startswith("Error executing job with overrides:") else self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


if __name__ == "__main__":
    run_command(main)
