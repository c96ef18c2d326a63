"""The only shell: workspace folders, validated sections, threads, progress, errors. Stages are called through it.

A stage in pipelines/ is a function `(workspace[, name]) -> Report`; `main` makes a command of it.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.orchestration.mlflow_logging import MethodResult, Report, log_run

S = TypeVar("S", bound=Settings)
A = TypeVar("A")
B = TypeVar("B")


__all__ = [
    "MethodResult",
    "Report",
    "Workspace",
    "configure_environment",
    "main",
    "parallel_backend",
    "parallel_map",
    "progress_bar",
    "run_command",
    "run_stage",
]

Stage = Callable[..., Report]

CHECKSUMS_FILE = "SHA256SUMS"


@dataclass(frozen=True)
class Workspace:
    """A folder that holds data/ and the resolved composition (params.yaml) that fills it.

    `sections_read` records what `settings` was asked for, so that a run is logged with the parameters it used.
    `on_validation` is told the figures of every validation of a training, and may raise to end one that leads nowhere.
    """

    root: Path
    params: Mapping[str, Any]
    sections_read: set[str] = field(default_factory=set, compare=False, repr=False)
    on_validation: Callable[[int, dict[str, float]], None] | None = field(default=None, compare=False, repr=False)

    @classmethod
    def open(cls, root: Path) -> Workspace:
        """The workspace in `root`. Raises InputError if its params.yaml is missing or not a mapping."""
        path = root / "params.yaml"
        try:
            params = yaml.safe_load(path.read_text())
        except (OSError, yaml.YAMLError) as error:
            raise InputError(f"{path}: cannot be read ({error}); `make params` writes it") from None
        if not isinstance(params, dict):
            raise InputError(f"{path}: should be a mapping of sections; `make params` writes it")
        return cls(root, params)

    def settings(self, section: str, settings_class: type[S]) -> S:
        """The section at a dotted key, validated. Raises InputError: the key, the bound and the value that came."""
        node: Any = self.params
        for key in section.split("."):
            if not isinstance(node, Mapping) or key not in node:
                raise InputError(f"params: section {section} is missing; `make params` writes it from conf/")
            node = node[key]
        self.sections_read.add(section)
        return validate_section(section, settings_class, node)

    @property
    def corpus(self) -> Path:
        """The corpus that every stage after `synthesize` reads."""
        return self.root / str(self.params["corpus"])

    @property
    def jobs(self) -> int:
        """How many processes clip-parallel work uses."""
        return int(self.params["machine"]["jobs"])

    def data(self, *parts: str) -> Path:
        """A path under data/."""
        return self.root.joinpath("data", *parts)

    @contextmanager
    def output(self, *parts: str, fingerprint: str | None = None) -> Iterator[Path]:
        """A new folder that becomes data/<parts> only when the block ends well: never a half-made output.

        SHA256SUMS in it stands for all its files: DVC looks at one file for each stage that reads thousands.
        A stage with a `fingerprint` of what it is made of finds again what a run of the very same left when it was cut
        off.
        """
        final = self.data(*parts)
        partial = final.with_name(f".{final.name}.partial")
        mark = partial / "FINGERPRINT"
        if fingerprint is None or not mark.is_file() or mark.read_text() != fingerprint:
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
            if fingerprint is not None:
                mark.write_text(fingerprint)
        try:
            yield partial
            mark.unlink(missing_ok=True)
            (partial / CHECKSUMS_FILE).write_text(checksums(partial))
        except BaseException:
            if fingerprint is None:
                shutil.rmtree(partial, ignore_errors=True)
            raise
        shutil.rmtree(final, ignore_errors=True)
        partial.rename(final)


def code_digest(rooms: Iterable[str]) -> str:
    """A hash of the package's own code in these rooms and files: what an unfinished output may have been made by."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for room in rooms:
        for path in sorted([package / room] if room.endswith(".py") else (package / room).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def checksums(folder: Path) -> str:
    """What `sha256sum` prints for the files of a folder."""
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names)


def parallel_map(function: Callable[[A], B], items: Iterable[A], jobs: int, title: str) -> Iterator[B]:
    """The one joblib call for clip-parallel work: results in order, a progress bar, memory that does not grow.

    `parallel_backend` says where it runs. Inside a worker of another joblib call (a job of a sweep) items go one after
    another: the cores are taken already, and the threads that joblib would use there share torch's seed.
    """
    import joblib
    from joblib.parallel import get_active_backend

    backend = get_active_backend()[0]
    items = list(items)
    tasks = (joblib.delayed(function)(item) for item in items)
    results = joblib.Parallel(
        n_jobs=1 if backend.nesting_level else jobs,
        return_as="generator" if backend.supports_return_generator else "list",
        pre_dispatch="4*n_jobs",
    )(tasks)
    yield from progress_bar(results, title, len(items))


@contextmanager
def parallel_backend(machine: Mapping[str, Any]) -> Iterator[None]:
    """Where `parallel_map` runs: processes of this machine, or Ray (docs/scale.md), as the section `machine` says."""
    if machine.get("backend", "processes") == "processes":
        yield
        return
    import joblib
    import ray
    from ray.util.joblib import register_ray

    if not ray.is_initialized():
        ray.init(**_cluster(machine))
    register_ray()
    with joblib.parallel_config("ray"):
        yield


def _cluster(machine: Mapping[str, Any]) -> dict[str, Any]:
    """What Ray is started with: a standing cluster, or one of its own that only this machine sees."""
    if machine["ray_address"] is not None:
        return {"address": machine["ray_address"], "log_to_driver": False}
    size = {"num_cpus": int(machine["jobs"])}
    return {**size, "include_dashboard": False, "log_to_driver": False, "_node_ip_address": "127.0.0.1"}


def progress_bar(items: Iterable[A], title: str, total: int | None = None) -> Iterable[A]:
    """The progress bar of everything that takes longer than a few seconds."""
    from tqdm import tqdm

    bar: Iterable[A] = tqdm(items, desc=title, total=total, mininterval=0.5, file=sys.stderr)
    return bar


def configure_environment() -> None:
    """One thread a process, and no telemetry of any dependency. Called before they are imported."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    os.environ.update(
        MLFLOW_DISABLE_TELEMETRY="true",
        DO_NOT_TRACK="true",
        DVC_NO_ANALYTICS="1",
        RAY_USAGE_STATS_ENABLED="0",
        HF_HUB_DISABLE_TELEMETRY="1",
    )


def run_command(command: Callable[[], None]) -> NoReturn:
    """Run a command and leave: status 2 and one line on stderr for what a person can mend, 130 when interrupted."""
    configure_environment()
    try:
        command()
    except InputError as error:
        print("error:", " ".join(str(error).splitlines()), file=sys.stderr)  # some causes quote several lines
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)


def main(run: Stage) -> NoReturn:
    """The command of a stage in the current folder; a stage over named items takes the name as its one argument."""
    expected = list(inspect.signature(run).parameters)[1:]
    given = sys.argv[1:]
    stage = Path(inspect.getfile(run)).stem
    if run.__module__ == "__main__":  # worker processes must find the functions of the script by name
        run = importlib.import_module(f"pipelines.{stage}").run

    def command() -> None:
        if len(given) != len(expected):
            raise InputError(
                f"{stage}: should get {' '.join(expected) or 'no arguments'}, got {' '.join(given) or 'none'}"
            )
        run_stage(stage, run, Workspace.open(Path.cwd()), *given)

    run_command(command)


def run_stage(stage: str, run: Stage, workspace: Workspace, *names: str) -> Report:
    """Run a stage and log it to MLflow: parameters of the sections that it read, metrics, files, duration."""
    workspace.sections_read.clear()
    start = time.monotonic()
    with parallel_backend(workspace.params.get("machine", {})):
        report = run(workspace, *names)
    seconds = time.monotonic() - start
    title = "-".join([stage, *names])
    log_run(workspace.root, stage, title, workspace.params, workspace.sections_read, seconds, report)
    return report
