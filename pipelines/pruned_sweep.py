"""The second way to sweep: processes ask trials of one study and tell what came of them, and bad ones end early.

Run     python -m pipelines.pruned_sweep sweep=free_running [overrides]; on all machines that share the study's storage
Reads   the same sweep, study and store as `pipelines.experiment -m sweep=free_running`; each can resume the other
Writes  what a sweep writes (docs/sweeps.md)

Hydra's sweeper cannot prune. Here every validation of a training is reported to the study, and a trial whose figures
are below the median of the others at the same step ends there. Of one objective only: Optuna prunes no other.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipelines.experiment import run_pipeline
from pipelines.optuna_study import (
    OptunaStudy,
    distributions,
    open_study,
    prepare,
    read,
    silence_warnings,
    write_results,
)
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command

# So many trials are finished before one is measured by them.
STARTUP_TRIALS = 4


def main() -> None:
    """As many processes as machine.jobs, each taking trials until none is left."""
    import joblib

    silence_warnings()
    overrides = sys.argv[1:]
    study = prepare(overrides)
    if study is None:
        raise InputError("sweep: should be a search of Optuna with a storage, such as sweep=free_running")
    if len(study.search.directions) != 1:
        raise InputError(f"sweep: pruning needs one objective, got {study.search.params['objective']['metrics']}")
    jobs = int(study.search.params["machine"]["jobs"])
    with study.exclusive(join=True):
        joblib.Parallel(n_jobs=jobs)(joblib.delayed(run_trials)(overrides) for _ in range(jobs))
    write_results(study)


def run_trials(overrides: Sequence[str]) -> None:
    """Make trials until the study has enough, finished or begun by anybody."""
    import optuna

    silence_warnings()
    search = read(overrides)
    assert search is not None
    study = open_study(search)
    study.optuna.pruner = optuna.pruners.MedianPruner(n_startup_trials=STARTUP_TRIALS)
    while (trial := _next(study)) is not None:
        try:
            value = _trial(study, trial, overrides)
        except optuna.TrialPruned:
            study.optuna.tell(trial, state=optuna.trial.TrialState.PRUNED)
        except BaseException:
            study.optuna.tell(trial, state=optuna.trial.TrialState.FAIL)
            raise
        else:
            study.optuna.tell(trial, value)


def _next(study: OptunaStudy) -> Any:
    """A trial, unless all are finished or begun; processes of one workspace ask in turn."""
    from filelock import FileLock

    with FileLock(Path(study.search.params["workspace"], f".{study.search.name}.ask.lock")):
        trials = study.optuna.get_trials(deepcopy=False)
        begun = sum(trial.state.name == "RUNNING" for trial in trials)
        study.optuna.sampler = study.search.sampler(len(trials))  # no two trials are drawn from the same seed
        return study.optuna.ask(distributions(study.search)) if study.remaining_trials > begun else None


def _trial(study: OptunaStudy, trial: Any, overrides: Sequence[str]) -> float:
    """Run the chain with what was suggested. Raises TrialPruned."""
    import optuna

    sign = 1 if study.search.directions[0] == "maximize" else -1

    def on_validation(step: int, figures: dict[str, float]) -> None:
        trial.report(sign * figures["validation_score"], step)
        if trial.should_prune():
            raise optuna.TrialPruned

    chosen = [*study.search.fixed, *(f"{key}={value}" for key, value in trial.params.items())]
    params = compose(chosen)
    return run_pipeline(
        params, Path(params["workspace"], "jobs", f"{study.search.name}-{trial.number}"), chosen, on_validation
    )[0]


if __name__ == "__main__":
    run_command(
        importlib.import_module("pipelines.pruned_sweep").main
    )  # by its name, so that worker processes find `run_trials`
