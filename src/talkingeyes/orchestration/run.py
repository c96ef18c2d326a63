"""The shell of all stages and commands: workspace folders, validated sections, threads, progress, errors.

A stage in pipelines/ is a function `(workspace[, name]) -> Report`; `main` turns it into a command.
"""

from __future__ import annotations

import atexit
import errno
import hashlib
import importlib
import inspect
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from talkingeyes.core.errors import InputError
from talkingeyes.core.output_folder import replace_folder
from talkingeyes.core.progress import progress_bar
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.orchestration.mlflow_logging import MethodResult, Report, log_run

S = TypeVar("S", bound=Settings)
A = TypeVar("A")
B = TypeVar("B")
Function = TypeVar("Function", bound=Callable[..., object])


__all__ = [
    "MethodResult",
    "Report",
    "Workspace",
    "configure_environment",
    "main",
    "parallel_backend",
    "parallel_map",
    "run_command",
    "run_stage",
]

Stage = Callable[..., Report]

OF_DISKS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)
CHECKSUMS_FILE = "SHA256SUMS"
# `make repro` sets it to 1 where two rows of stages run side by side: workers of a row would wait for the other's core,
# and each imports torch.
JOBS_VARIABLE = "TALKINGEYES_JOBS"
SEAL = "SEALED"  # file in a corpus that only the report of a release may read


@dataclass(frozen=True)
class InputPaths:
    """What worker processes read for a row of a report; `sample` and `model` exist for generators only."""

    row: str
    corpus: Path
    fit: Path
    embed: Path
    critic: Path
    sample: Path
    model: Path


@dataclass(frozen=True)
class Workspace:
    """A folder with data/ and the resolved composition (params.yaml) that produces it.

    `may_read_sealed`: whether this is the report of a release (pipelines/results/release_report.py).
    `sections_read` records the sections requested from `settings`, so that a run is logged with the parameters it used.
    `on_validation` receives the metrics of every validation of a training, and may raise to prune it.
    """

    root: Path
    params: Mapping[str, Any]
    may_read_sealed: bool = False
    sections_read: set[str] = field(default_factory=set, compare=False, repr=False)
    on_validation: Callable[[int, dict[str, float]], None] | None = field(default=None, compare=False, repr=False)

    @classmethod
    def open(cls, root: Path) -> Workspace:
        """The workspace in `root`. Raises InputError if its params.yaml is missing or not a mapping."""
        from talkingeyes.core.containers import read_yaml  # needs numpy, and `--help` imports this file

        path = root / "params.yaml"
        params = read_yaml(path, "YAML file, which `make params` writes")
        if not isinstance(params, dict):
            raise InputError(f"{path}: should be a mapping of sections; `make params` writes it")
        return cls(root, params)

    def settings(self, section: str, settings_class: type[S]) -> S:
        """The validated section at a dotted key. Raises InputError with the key, its bound and the given value."""
        node: Any = self.params
        for key in section.split("."):
            if not isinstance(node, Mapping) or key not in node:
                raise InputError(
                    f"params: should contain section {section}, got none; `make params` writes it from conf/"
                )
            node = node[key]
        self.sections_read.add(section)
        return validate_section(section, settings_class, node)

    @property
    def corpus(self) -> Path:
        """The corpus that every stage after `synthesize` reads. Raises InputError if it is sealed."""
        corpus = self.root / str(self.params["corpus"])
        if (corpus / SEAL).exists() and not self.may_read_sealed:
            raise InputError(f"corpus: {corpus} is sealed for the reports of releases; nothing may be chosen by it")
        return corpus

    @property
    def jobs(self) -> int:
        """Number of processes of clip-parallel work; TALKINGEYES_JOBS goes before machine.jobs."""
        given = os.environ.get(JOBS_VARIABLE)
        if given is None:
            return int(self.params["machine"]["jobs"])
        if not given.isdecimal() or int(given) < 1:
            raise InputError(f"{JOBS_VARIABLE}: should be a number of processes, got {given!r}")
        return int(given)

    def data(self, *parts: str) -> Path:
        """A path under data/."""
        return self.root.joinpath("data", *parts)

    def input_paths(self, row: str) -> InputPaths:
        """The paths that worker processes read for a row of a report."""
        data = self.data
        own = data("sample", row), data("train", row)
        return InputPaths(row, self.corpus, data("fit"), data("embed"), data("critic"), *own)

    @contextmanager
    def output(self, *parts: str, fingerprint: str | None = None) -> Iterator[Path]:
        """A new folder that becomes data/<parts> only if the block succeeds, so an output is never incomplete.

        SHA256SUMS in it represents all its files: DVC tracks one file per stage, where a stage reads thousands. A stage
        with a `fingerprint` of its dependencies finds the partial output of an interrupted run with the same
        fingerprint.
        """
        final = self.data(*parts)
        partial = final.with_name(f".{final.name}.partial")
        mark = partial / "FINGERPRINT"
        partial.mkdir(parents=True, exist_ok=True)
        with _only_writer(partial):
            if fingerprint is None or not mark.is_file() or mark.read_text() != fingerprint:
                for left in partial.iterdir():
                    shutil.rmtree(left) if left.is_dir() else left.unlink()
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
            replace_folder(final, partial)


@contextmanager
def _only_writer(folder: Path) -> Iterator[None]:
    """Lock a folder itself, so that no lock file stays. Raises InputError if another process holds it."""
    import fcntl  # stages need Linux, other commands do not

    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{folder}: another process is writing this output; wait for its end") from None
        yield
    finally:
        os.close(handle)


def code_digest(rooms: Iterable[str]) -> str:
    """A hash of the *.py and *.txt in these packages and files, to recognise partial outputs of other code."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for room in rooms:
        files = [package / room] if room.endswith(".py") else (package / room).rglob("*.*")
        for path in sorted(each for each in files if each.suffix in (".py", ".txt")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def checksums(folder: Path) -> str:
    """The output of `sha256sum` for the files of a folder."""
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names)


def parallel_map(function: Callable[[A], B], items: Iterable[A], jobs: int, title: str) -> Iterator[B]:
    """Map over clips with joblib: results in order, a progress bar, and constant memory.

    `parallel_backend` sets where it runs. Inside a worker of another joblib call (a job of a sweep), items are
    processed sequentially: the cores are already in use, and the threads that joblib would start there share torch's
    seed.
    """
    from concurrent.futures.process import BrokenProcessPool

    import joblib
    from joblib.parallel import get_active_backend

    backend = get_active_backend()[0]
    items = list(items)
    tasks = (joblib.delayed(function)(item) for item in items)
    parallel = joblib.Parallel(
        n_jobs=1 if backend.nesting_level else jobs,
        return_as="generator" if backend.supports_return_generator else "list",
        pre_dispatch="4*n_jobs",
    )
    try:
        with _without_interrupts() if backend.supports_return_generator else nullcontext():
            results = parallel(tasks)
        yield from progress_bar(results, title, len(items))
    except BrokenProcessPool:
        raise InputError(f"{title}: a process was killed, perhaps for want of memory") from None


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Workers that start here leave Ctrl-C to this process, which ends them; else each shows a traceback."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def parallel_backend(machine: Mapping[str, Any]) -> Iterator[None]:
    """Backend of `parallel_map`, set by the section `machine`: processes of this machine, or Ray (docs/scale.md)."""
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
    """Arguments of ray.init: an existing cluster, or a new local one that only this machine can reach."""
    if machine["ray_address"] is not None:
        return {"address": machine["ray_address"], "log_to_driver": False}
    size = {"num_cpus": int(machine["jobs"])}
    return {**size, "include_dashboard": False, "log_to_driver": False, "_node_ip_address": "127.0.0.1"}


def configure_environment() -> None:
    """Set one thread per process, or OMP_NUM_THREADS if it is set, and disable the telemetry of dependencies. Call
    before they are imported."""
    threads = os.environ.setdefault("OMP_NUM_THREADS", "1")
    for name in ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, threads)
    os.environ.update(
        MLFLOW_DISABLE_TELEMETRY="true",
        DO_NOT_TRACK="true",
        DVC_NO_ANALYTICS="1",
        RAY_USAGE_STATS_ENABLED="0",
        HF_HUB_DISABLE_TELEMETRY="1",
    )


def run_command(command: Callable[[], None]) -> NoReturn:
    """Run a command and exit: status 2 and one line for an InputError or a full disk, 130 when interrupted."""
    configure_environment()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # what is written is whole, and the status is 0
    command = _by_module_name(command)
    try:
        command()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        if error.errno not in OF_DISKS:
            raise
        where = error.filename or Path.cwd()
        print(f"error: {where}: cannot be read or written ({error.strerror})", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)


def _by_module_name(function: Function) -> Function:
    """The function of a program run by `python -m`, from its module: worker processes cannot import from `__main__`."""
    program = sys.modules["__main__"].__spec__
    if program is None or function.__module__ != "__main__":
        return function
    named: Function = getattr(importlib.import_module(program.name), function.__name__, function)
    return named


def main(run: Stage) -> NoReturn:
    """Command of a stage in the current folder; a stage over named items takes the name as its only argument."""
    expected = required_arguments(run)
    given = sys.argv[1:]
    stage = Path(inspect.getfile(run)).stem
    run = _by_module_name(run)

    def command() -> None:
        if len(given) != len(expected):
            raise InputError(
                f"{stage}: should get {' '.join(expected) or 'no arguments'}, got {' '.join(given) or 'none'}"
            )
        run_stage(stage, run, Workspace.open(Path.cwd()), *given)

    run_command(command)


def required_arguments(run: Stage) -> list[str]:
    """Arguments of the command of a stage: those that `run` takes after the workspace and that have no default."""
    parameters = list(inspect.signature(run).parameters.values())[1:]
    return [each.name for each in parameters if each.default is inspect.Parameter.empty]


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
