"""Optuna study behind a sweep: its storage, a check that the search is unchanged, and the remaining trials.

Hydra's sweeper asks for trials and reports their results; this module manages the study around it. An interrupted sweep
resumes: trials left running count as failed, n_trials refers to the whole study, and the sampler's seed is advanced by
the number of trials, because a sampler that restarts from its seed proposes the same trials again.

Reads   conf/ as composed by Hydra, and the study's storage
Writes  the study; at the end <workspace>/<study>/: trials.csv, importances.csv; with two objectives pareto.png; with
        `objective.seeds` front.csv, the trials of the front under these seeds
"""

from __future__ import annotations

import csv
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.config import CONFIG_DIR, compose, one_line_hydra_errors, validate_config
from talkingeyes.orchestration.mlflow_logging import log_study
from talkingeyes.orchestration.run import Report

# Runs a composition, with its links in a folder and its overrides; returns the objectives.
PipelineRunner = Callable[[dict[str, Any], Path, Sequence[str]], list[float]]
# User attribute of the study that stores the search space.
SPACE = "search_space"


def silence_warnings() -> None:
    """Silence warnings about the Optuna 2 distributions that the sweeper uses; they work, but warn at every step."""
    warnings.filterwarnings("ignore", category=FutureWarning, module="optuna|hydra_plugins")


@dataclass(frozen=True)
class SearchConfig:
    """A search as configured by conf/ and the command line: Hydra's search overrides, and the directions."""

    params: dict[str, Any]  # the composition
    name: str
    storage: Any
    directions: list[Literal["minimize", "maximize"]]
    fixed: list[str]  # overrides of the command line outside the search
    search_overrides: list[str]  # key=choice(...), key=interval(...)
    trials: int
    seed: int | None
    sampler: Callable[[int], Any]  # takes the number of past trials, added to the seed


@dataclass(frozen=True)
class OptunaStudy:
    """A search and its study in the storage."""

    search: SearchConfig
    optuna: Any

    @property
    def finished(self) -> int:
        """Number of trials that are complete or pruned."""
        return sum(trial.state.name in ("COMPLETE", "PRUNED") for trial in self.optuna.trials)

    @property
    def remaining_trials(self) -> int:
        """Number of trials still to run."""
        return max(0, self.search.trials - self.finished)

    def overrides(self) -> list[str]:
        """Overrides for Hydra's sweeper that continue the study."""
        found = [f"hydra.sweeper.n_trials={self.remaining_trials}"]
        if self.search.seed is not None:
            found.append(f"hydra.sweeper.sampler.seed={self.search.seed + len(self.optuna.trials)}")
        return found

    @contextmanager
    def exclusive(self, join: bool = False) -> Iterator[None]:
        """Lock the study for this workspace; trials that still run were then left by a killed process.

        With `join`, work beside another process. Raises InputError otherwise.
        """
        from filelock import FileLock, Timeout
        from optuna.trial import TrialState

        path = Path(self.search.params["workspace"]) / f".{self.search.name}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            if not join:
                raise InputError(
                    f"study {self.search.name}: should be idle, got a running sweep; pipelines.pruned_sweep can join it"
                ) from None
        try:
            if lock.is_locked:
                for trial in self.optuna.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
                    self.optuna.tell(trial.number, state=TrialState.FAIL)
            yield
        finally:
            lock.release()


def storage(where: str) -> Any:
    """A storage: the URL of a relational database, or the path of a journal file."""
    import optuna
    from optuna.storages import JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if "://" in where:
        return RDBStorage(where)
    Path(where).parent.mkdir(parents=True, exist_ok=True)
    return JournalStorage(JournalFileBackend(where))


def prepare(overrides: Sequence[str]) -> OptunaStudy | None:
    """Validate a sweep before it starts; returns its study, if it has a persistent one.

    Raises InputError: an invalid override, a value outside its bounds, a study of another search.
    """
    search = read_search(overrides)
    for values in _boundary_overrides(search.search_overrides if search else _sweep_overrides(overrides)):
        compose([*_fixed_overrides(overrides), *values])
    return None if search is None else open_study(search)


def read_search(overrides: Sequence[str]) -> SearchConfig | None:
    """The search that the overrides define; None without Optuna or without a storage."""
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    with one_line_hydra_errors(), initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        config = hydra_compose("config", overrides=_fixed_overrides(overrides), return_hydra_config=True)
    with one_line_hydra_errors():
        params = validate_config(
            OmegaConf.to_container(OmegaConf.masked_copy(config, [k for k in config if k != "hydra"]), resolve=True)
        )
    sweeper = config.hydra.sweeper
    if "optuna" not in sweeper._target_ or sweeper.storage is None:
        return None
    kept = storage(sweeper.storage) if isinstance(sweeper.storage, str) else instantiate(sweeper.storage)
    own = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
    directions = sweeper.direction if OmegaConf.is_list(sweeper.direction) else [sweeper.direction]
    seed = sweeper.sampler.get("seed")
    return SearchConfig(
        params=params,
        name=str(sweeper.study_name or params["study"]),
        storage=kept,
        directions=["maximize" if "max" in str(each).lower() else "minimize" for each in directions],
        fixed=_fixed_overrides(overrides),
        search_overrides=[*own, *_sweep_overrides(overrides)],
        trials=int(sweeper.n_trials),
        seed=seed,
        sampler=lambda past: instantiate(sweeper.sampler, **({} if seed is None else {"seed": seed + past})),
    )


def open_study(search: SearchConfig) -> OptunaStudy:
    """The study in the storage, new or of the same search. Raises InputError if it is of another search."""
    import optuna

    figures = search.params["objective"]["metrics"]
    if len(figures) != len(search.directions):
        raise InputError(f"objective.metrics: should be one for each direction {search.directions}, got {figures}")
    found = optuna.create_study(
        study_name=search.name, storage=search.storage, directions=[*search.directions], load_if_exists=True
    )
    asked: dict[str, Any] = {"space": plain_search_space(search), "figures": figures, "directions": search.directions}
    before = found.user_attrs.get(SPACE)
    if before is None:
        found.set_user_attr(SPACE, asked)
    elif before != asked:
        now, then = asked["space"], before["space"]
        changed = ", ".join(sorted(key for key in now | then if now.get(key) != then.get(key))) or "the objective"
        raise InputError(
            f"study {search.name}: should have the same search as before, got changes of {changed}; "
            "start a new one with study=NAME"
        )
    return OptunaStudy(search, found)


def distributions(search: SearchConfig) -> dict[str, Any]:
    """The search space as Optuna distributions."""
    from hydra_plugins.hydra_optuna_sweeper._impl import create_params_from_overrides

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        found, _ = create_params_from_overrides(search.search_overrides)
    return dict(found)


def plain_search_space(search: SearchConfig) -> dict[str, Any]:
    """The search space as plain values, for comparison."""
    from optuna.distributions import distribution_to_json

    return {key: json.loads(distribution_to_json(each)) for key, each in sorted(distributions(search).items())}


def write_results(study: OptunaStudy, run_pipeline: PipelineRunner) -> None:
    """Write all trials and the importances of parameters, plot the Pareto front of two objectives, run the trials of
    the front with further seeds, and log all as the run of the study."""
    from optuna.trial import TrialState

    search, trials = study.search, study.optuna.get_trials(deepcopy=False)
    figures = search.params["objective"]["metrics"]
    complete = [trial for trial in trials if trial.state == TrialState.COMPLETE]
    folder = Path(search.params["workspace"]) / search.name
    folder.mkdir(parents=True, exist_ok=True)
    _write_trials(folder / "trials.csv", trials, figures)
    artifacts = [folder / "trials.csv"]
    if importances := _importances(study.optuna, len(figures)):
        artifacts.append(folder / "importances.csv")
        _write_importances(artifacts[-1], importances, figures)
    best = study.optuna.best_trials if complete else []
    if len(figures) == 2 and complete:
        from talkingeyes.evaluation.report.validation_metrics import plot_pareto_front

        artifacts.append(folder / "pareto.png")
        plot_pareto_front(
            [trial.values for trial in complete], [trial.values for trial in best], figures, artifacts[-1]
        )
    if seeds := search.params["objective"]["seeds"]:
        artifacts.append(folder / "front.csv")
        _write_front(artifacts[-1], search, best, seeds, figures, run_pipeline)
    states = {
        state: sum(trial.state.name.lower() == state for trial in trials) for state in ("complete", "pruned", "fail")
    }
    metrics = {f"trials_{state}": float(count) for state, count in states.items()}
    if len(figures) == 1 and best:
        metrics[f"best_{figures[0]}"] = best[0].values[0]
    log_study(Path(search.params["workspace"]), search.name, search.params["objective"], Report(metrics, artifacts))
    print(f"study {search.name}: {states['complete']} trials complete, {states['pruned']} pruned; {folder}")
    for trial in best:
        values = ", ".join(f"{name} {value:.4g}" for name, value in zip(figures, trial.values, strict=True))
        print(f"  {trial.number}: {values}: " + " ".join(f"{key}={value}" for key, value in trial.params.items()))


def _write_trials(path: Path, trials: Sequence[Any], figures: Sequence[str]) -> None:
    keys = sorted({key for trial in trials for key in trial.params})
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["trial", "state", *figures, *keys])
        for trial in trials:
            values = trial.values or [""] * len(figures)
            writer.writerow(
                [trial.number, trial.state.name.lower(), *values, *(trial.params.get(key, "") for key in keys)]
            )


def _write_front(
    path: Path,
    search: SearchConfig,
    best: Sequence[Any],
    seeds: Sequence[int],
    figures: Sequence[str],
    run_pipeline: PipelineRunner,
) -> None:
    """Objectives of the trials of the front with their own seed of training and with `seeds`: mean, least, greatest.
    What the store has is not run again."""
    import joblib

    own = search.params["train"]["seed"]
    tasks = [(trial, seed) for trial in best for seed in [own, *seeds]]

    def objectives(trial: Any, seed: int) -> list[float]:
        chosen = [*search.fixed, *(f"{key}={value}" for key, value in trial.params.items()), f"train.seed={seed}"]
        params = compose(chosen)
        view = Path(params["workspace"], "jobs", f"{search.name}-{trial.number}-seed-{seed}")
        return run_pipeline(params, view, chosen)

    found = joblib.Parallel(n_jobs=int(search.params["machine"]["jobs"]))(
        joblib.delayed(objectives)(trial, seed) for trial, seed in tasks
    )
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["trial", "seeds", *(f"{name}_{of}" for name in figures for of in ("mean", "min", "max"))])
        for trial in best:
            values = [row for (each, _), row in zip(tasks, found, strict=True) if each is trial]
            of_figures = zip(*values, strict=True)
            summary = [figure for each in of_figures for figure in (sum(each) / len(each), min(each), max(each))]
            writer.writerow([trial.number, " ".join(map(str, [own, *seeds])), *(f"{each:.6g}" for each in summary)])


def _importances(study: Any, objectives: int) -> list[dict[str, float]]:
    """Share of each parameter in the variance of each objective (fANOVA, Hutter et al. 2014); none if the trials do
    not determine it."""
    from optuna.importance import FanovaImportanceEvaluator, get_param_importances

    try:
        return [
            get_param_importances(
                study, evaluator=FanovaImportanceEvaluator(seed=0), target=partial(_objective_value, index)
            )
            for index in range(objectives)
        ]
    except (RuntimeError, ValueError):  # fewer than two complete trials, or equal values in all
        return []


def _objective_value(index: int, trial: Any) -> float:
    return float(trial.values[index])


def _write_importances(path: Path, importances: Sequence[Mapping[str, float]], figures: Sequence[str]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["parameter", *figures])
        for key in sorted(importances[0], key=importances[0].__getitem__, reverse=True):
            writer.writerow([key, *(f"{each[key]:.3f}" for each in importances)])


def _parsed(overrides: Sequence[str]) -> list[Any]:
    """Overrides parsed by Hydra. Raises InputError."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        return list(OverridesParser.create().parse_overrides(list(overrides)))
    except HydraException as error:
        raise InputError(" ".join(str(error).split())) from None


def _fixed_overrides(overrides: Sequence[str]) -> list[str]:
    return [each.input_line for each in _parsed(overrides) if not each.is_sweep_override()]


def _sweep_overrides(overrides: Sequence[str]) -> list[str]:
    return [each.input_line for each in _parsed(overrides) if each.is_sweep_override()]


# Maximum number of values of a key to check before a sweep: the first and the last of a longer list.
MAX_CHECKED_VALUES = 8


def _boundary_overrides(search_overrides: Sequence[str]) -> Iterator[list[str]]:
    """Overrides that check a sweep with single values: every choice and both ends of an interval, all keys at once."""
    values: dict[str, list[str]] = {}
    for each in _parsed(search_overrides):
        if each.is_interval_sweep():
            found = [str(each.value().start), str(each.value().end)]
        else:
            found = list(each.sweep_string_iterator())
        values[each.get_key_element()] = (
            found
            if len(found) <= MAX_CHECKED_VALUES
            else found[: MAX_CHECKED_VALUES // 2] + found[-MAX_CHECKED_VALUES // 2 :]
        )
    for index in range(max(map(len, values.values()), default=0)):
        yield [f"{key}={found[min(index, len(found) - 1)]}" for key, found in values.items()]
