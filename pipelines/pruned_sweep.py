"""Sweep with pruning: processes ask for trials of one study and report their results, and bad trials end early.

Run     python -m pipelines.pruned_sweep sweep=free_running [overrides]; on all machines that share the study's storage
Reads   the same sweep, study and store as `pipelines.experiment -m sweep=free_running`; each can resume the other
Writes  the output of a sweep (docs/sweeps.md)

Hydra's sweeper cannot prune, and Optuna prunes no search with several objectives. Here the score of every validation of
a training is kept with its trial, and a trial whose score is below the median of the others at the same step is pruned.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from pipelines.experiment import run_pipeline
from pipelines.optuna_study import (
    OptunaStudy,
    distributions,
    open_study,
    prepare,
    read_search,
    silence_warnings,
    write_results,
)
from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import compose, quote_texts
from talkingeyes.orchestration.run import run_command

STARTUP_TRIALS = 4  # trials with a score at a step before any is pruned there
SCORE = "validation_score@{}"  # attribute of a trial


def main() -> None:
    """Start `machine.jobs` processes, each taking trials until none is left."""
    import joblib

    silence_warnings()
    overrides = quote_texts(sys.argv[1:], sweep=True)
    study = prepare(overrides)
    if study is None:
        raise InputError("sweep: should be a search of Optuna with a storage, such as sweep=free_running")
    jobs = int(study.search.params["machine"]["jobs"])
    with study.exclusive(join=True):
        joblib.Parallel(n_jobs=jobs)(joblib.delayed(run_trials)(overrides) for _ in range(jobs))
    write_results(study, run_pipeline)


def run_trials(overrides: Sequence[str]) -> None:
    """Run trials until the study has enough that are finished or running."""
    import optuna

    silence_warnings()
    search = read_search(overrides)
    assert search is not None
    study = open_study(search)
    while (trial := _next(study)) is not None:
        try:
            values = _trial(study, trial)
        except optuna.TrialPruned:
            study.optuna.tell(trial, state=optuna.trial.TrialState.PRUNED)
        except BaseException:
            study.optuna.tell(trial, state=optuna.trial.TrialState.FAIL)
            raise
        else:
            study.optuna.tell(trial, values)


def _next(study: OptunaStudy) -> Any:
    """A new trial, unless enough are finished or running; processes of one workspace take turns."""
    from filelock import FileLock

    with FileLock(Path(study.search.params["workspace"], f".{study.search.name}.ask.lock")):
        trials = study.optuna.get_trials(deepcopy=False)
        begun = sum(trial.state.name == "RUNNING" for trial in trials)
        study.optuna.sampler = study.search.sampler(len(trials))  # no two trials are sampled from the same seed
        return study.optuna.ask(distributions(study.search)) if study.remaining_trials > begun else None


def _trial(study: OptunaStudy, trial: Any) -> list[float]:
    """Run the pipeline with the suggested values; returns its objectives. Raises TrialPruned."""
    import optuna

    def on_validation(step: int, figures: dict[str, float]) -> None:
        score = figures["validation_score"]
        trial.set_user_attr(SCORE.format(step), score)
        others = [each.user_attrs.get(SCORE.format(step)) for each in study.optuna.get_trials(deepcopy=False)]
        known = [each for each in others if each is not None]
        if len(known) > STARTUP_TRIALS and score < median(known):
            raise optuna.TrialPruned

    chosen = [*study.search.fixed, *(f"{key}={value}" for key, value in trial.params.items())]
    params = compose(chosen)
    return run_pipeline(
        params, Path(params["workspace"], "jobs", f"{study.search.name}-{trial.number}"), chosen, on_validation
    )


if __name__ == "__main__":
    run_command(main)
