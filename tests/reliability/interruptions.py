"""Disturb commands and stages at random moments, run them again, and compare: `make reliability`, docs/reliability.md.

After a disturbance, what an operation writes is absent or as an undisturbed run writes it; the same call again ends
with the same bytes, and nothing else is left beside them. What is not killed says one line, with status 2, or 130 after
Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import toy_motions
from command_line import call
from fuzz_targets import write_good_files
from model_conf import compose
from toy_model import sound_file
from toy_training import toy_training

from talkingeyes.orchestration.config import write_params

TIME_S = 600
WHOLE = ("earlier output", "an existing one")  # what a command says whose output was whole when it was killed
PROGRAM = [sys.executable, "-c", "from talkingeyes.cli.main import main; main()"]
RECORDS = ("mlflow.db", "mlartifacts", ".dvc/tmp", ".dvc/cache/runs", "multirun")  # of runs, which hold times
TELLS_TIMES = ("summary.", "provenance.json", "__pycache__", ".dvc/cache/files")  # or hold the same bytes again
REPOSITORY = Path(__file__).resolve().parents[2]
STAGE = [sys.executable, "-m"]
TINY = ["experiment=tiny", "result_store=store", "workspace=w"]


@dataclass(frozen=True)
class Operation:
    """A call, the files that it needs, and what it writes; `resumes`: its output grows and is taken up again;
    `foreign`: another program's, which has words and statuses of its own for a failure."""

    name: str
    words: list[str]
    outputs: tuple[str, ...]
    needs: Callable[[Path, Path], None]
    resumes: bool = False
    foreign: bool = False


def _files(*names: str) -> Callable[[Path, Path], None]:
    def copy(good: Path, place: Path) -> None:
        for name in names:
            (shutil.copytree if (good / name).is_dir() else shutil.copy)(good / name, place / name)

    return copy


def _sounds(good: Path, place: Path) -> None:
    _files("model")(good, place)
    (place / "sounds").mkdir()
    for name in "abc":
        shutil.copy(good / "s.wav", place / "sounds" / f"{name}.wav")


def _film(good: Path, place: Path) -> None:
    toy_motions.motion().save(place / "talk.npz")
    sound_file(place / "talk.wav", 3.0)
    assert (
        call("render", place / "talk.npz", "-o", place / "speech.mp4", "--size", 256, "--sound", place / "talk.wav")
        == 0
    )


def _training(good: Path, place: Path) -> None:
    toy_training(place, steps=20, validate_every=4, batch=4)


def _corpus(good: Path, place: Path) -> None:
    write_params(place / "params.yaml", compose(["experiment=tiny", "machine.jobs=2", "synthesize.clips=12"]))


def _nothing(good: Path, place: Path) -> None:
    """Nothing is needed."""


def _repository(good: Path, place: Path) -> None:
    write_params(place / "params.yaml", compose(["experiment=tiny", "synthesize.clips=12"]))
    for name in ("src", "pipelines", "dvc.yaml", ".dvcignore"):
        (shutil.copytree if (REPOSITORY / name).is_dir() else shutil.copy)(REPOSITORY / name, place / name)
    subprocess.run([sys.executable, "-m", "dvc", "init", "--no-scm", "-q"], cwd=place, check=True)


def operations() -> list[Operation]:
    """What is killed."""
    animate = [*PROGRAM, "animate", "--model", "model", "--samples", "2", "-o", "out"]
    return [
        Operation(
            "export",
            [*PROGRAM, *["export", "motion.npz", "-f", "glb", "-o", "out.glb"]],
            ("out.glb",),
            _files("motion.npz"),
        ),
        Operation("import", [*PROGRAM, *["import", "bones.bvh", "-o", "out.npz"]], ("out.npz",), _files("bones.bvh")),
        Operation(
            "add-eyes",
            [*PROGRAM, *["add-eyes", "face.glb", "s.wav", "-o", "out.glb", "--model", "model"]],
            ("out.glb",),
            _files("face.glb", "s.wav", "model"),
        ),
        Operation(
            "pack", [*PROGRAM, *["pack", "model", "-o", "out.safetensors"]], ("out.safetensors",), _files("model")
        ),
        Operation(
            "render",
            [*PROGRAM, *["render", "motion.npz", "-o", "out.mp4", "--size", "64"]],
            ("out.mp4",),
            _files("motion.npz"),
        ),
        Operation("animate", [*animate, "s.wav"], ("out",), _files("model", "s.wav"), resumes=True),
        Operation("animate a folder", [*animate, "sounds", "--jobs", "2"], ("out",), _sounds, resumes=True),
        Operation(
            "track", [*PROGRAM, *["track", "speech.mp4", "-o", "out", "--keep-silent"]], ("out",), _film, resumes=True
        ),
        Operation(
            "pretrain", [sys.executable, "-m", "pipelines.pretrain", "codes"], ("data/pretrain/codes",), _training
        ),
        Operation("critic", [*STAGE, "pipelines.critic"], ("data/critic",), _training),
        Operation("synthesize", [*STAGE, "pipelines.synthesize"], ("data/synthesize",), _corpus),
        Operation(
            "dvc repro",
            [*STAGE, "dvc", "repro", "-q", "fit"],
            ("data",),
            _repository,
            resumes=True,
            foreign=True,
        ),
        Operation(
            "sweep of two processes",
            [*STAGE, "pipelines.experiment", "-m", *TINY, "machine.jobs=2", "target=train@vae", "train.seed=0,1"],
            ("store",),
            _nothing,
            resumes=True,
        ),
        Operation("tiny chain", [*STAGE, "pipelines.experiment", *TINY], ("store", "w/data"), _nothing, resumes=True),
    ]


def tree(place: Path) -> dict[str, str]:
    """Digest of every file below a folder, but for the record of runs."""
    found = {}
    for path in sorted(place.rglob("*")):
        name = path.relative_to(place).as_posix()
        told = name.startswith(RECORDS) or any(part in name for part in TELLS_TIMES) or "/mlflow.db" in name
        if path.is_file() and not told:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@dataclass(frozen=True)
class Disturbance:
    """What is done to a running operation, and the exit statuses that it may end with besides 0."""

    name: str
    statuses: tuple[int, ...]
    signal: signal.Signals | None = None  # sent to the process and its children at a random moment
    worker_dies: bool = False  # one child is killed at a random moment
    file_bytes: int | None = None  # largest file that can be written, up to this; then the disk is full
    homeless: bool = False  # no HOME, and caches that cannot be written


DISTURBANCES = (
    Disturbance("killed", (-signal.SIGKILL,), signal=signal.SIGKILL),
    Disturbance("Ctrl-C", (130, -signal.SIGINT), signal=signal.SIGINT),  # a shell calls both 130
    Disturbance("dead worker", (2,), worker_dies=True),
    Disturbance("full disk", (2,), file_bytes=60_000),
    Disturbance("no home", (), homeless=True),
)


def run(
    operation: Operation, place: Path, how: Disturbance | None = None, share: float = 1.0, seconds: float = 0.0
) -> tuple[int, str]:
    """Exit status and stderr. `share` of `seconds`, or of the size of a file, passes before the disturbance."""
    environment = dict(os.environ)
    if how and how.homeless:
        del environment["HOME"]
        environment |= dict.fromkeys(
            ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR", "NUMBA_CACHE_DIR"), "/proc/none"
        )

    with subprocess.Popen(
        operation.words,
        cwd=place,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    ) as process:
        if how and how.file_bytes is not None:
            most = int(share * how.file_bytes)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
        timed = how is not None and (how.signal is not None or how.worker_dies)
        try:
            said = process.communicate(timeout=share * seconds if timed else TIME_S)[1]
        except subprocess.TimeoutExpired:
            _disturb(process.pid, how)
            said = process.communicate(timeout=TIME_S)[1]
    return process.returncode, said


def _disturb(process: int, how: Disturbance | None) -> None:
    with contextlib.suppress(ProcessLookupError, psutil.NoSuchProcess):
        if how is None or how.signal is not None:
            os.killpg(process, signal.SIGKILL if how is None or how.signal is None else how.signal)
        elif children := psutil.Process(process).children(recursive=True):
            children[-1].kill()


def _below(found: dict[str, str], outputs: Sequence[str]) -> dict[str, str]:
    return {name: digest for name, digest in found.items() if name.startswith(tuple(outputs))}


def disturb_and_resume(
    operation: Operation, how: Disturbance, share: float, template: Path, whole: Whole, place: Path
) -> str | None:
    """What is wrong after a disturbance, or None."""
    shutil.copytree(template, place)
    status, said = run(operation, place, how, share, whole.seconds)
    lines = [line for line in said.splitlines() if line.strip() and "|" not in line]
    if status not in (0, *how.statuses) and not operation.foreign:
        return f"status {status}: {' / '.join(lines[-2:])[:200]}"
    if "Traceback" in said or (status == 2 and (not lines or not lines[-1].startswith("error: "))):
        return f"no single line: {' / '.join(lines[-2:])[:200]}"
    written = _below(tree(place), operation.outputs)
    if written and not operation.resumes and written != _below(whole.files, operation.outputs):
        return "output in part"
    if status != 0:
        status, said = run(operation, place)
        if status != 0 and not (written and any(text in said for text in WHOLE)):
            return f"status {status} of the second run: {said[-200:]}"
    found = tree(place)
    if strange := sorted(set(found) - set(whole.files)):
        return f"left {strange[0]}"
    differing = [name for name in whole.files if found.get(name) != whole.files[name]]
    return f"other bytes in {differing[0]}" if differing else None


@dataclass(frozen=True)
class Whole:
    """What an undisturbed run of an operation leaves, and its duration."""

    files: dict[str, str]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Disturb each operation a number of times; prints faults, and how many were tried and failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="of each operation; a tenth of it by other disturbances")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="operations whose name contains this")
    given = parser.parse_args(arguments)
    os.environ["PYTHONPATH"] = os.pathsep.join(os.path.abspath(path) for path in sys.path if path)
    tried, failed = Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory(prefix="talkingeyes-interruptions-") as folder:
        root = Path(folder)
        write_good_files(root / "good")
        for index, operation in enumerate(each for each in operations() if given.only in each.name):
            template, place = root / f"{index}-template", root / f"{index}-place"
            template.mkdir()
            operation.needs(root / "good", template)
            shutil.copytree(template, place)
            started = time.monotonic()
            status, said = run(operation, place)
            whole = Whole(tree(place), time.monotonic() - started)
            shutil.rmtree(place)
            if status or not _below(whole.files, operation.outputs):
                raise SystemExit(f"{operation.name}: status {status}: {said[-500:]}")
            print(f"{operation.name}, {whole.seconds:.1f} s", flush=True)
            for number, how in enumerate(DISTURBANCES):
                count = given.kills if number == 0 else 1 if how.homeless else max(1, given.kills // 10)
                faults = []
                for share in np.random.default_rng([given.seed, index, number]).uniform(0.2, 1.0, count):
                    fault = disturb_and_resume(operation, how, share, template, whole, place)
                    if fault:
                        faults.append(f"        at {share:.2f}: {fault}")
                    shutil.rmtree(place)
                print(f"    {how.name:12} {count} tried, {len(faults)} failed", *faults[:5], sep="\n", flush=True)
                tried[how.name] += count
                failed[how.name] += len(faults)
    print("\nby disturbance")
    for name, count in tried.items():
        print(f"{name:12} {count} tried, {failed[name]} failed")
    print(f"{tried.total()} tried, {failed.total()} failed, seed {given.seed}")
    sys.exit(1 if failed.total() else 0)


if __name__ == "__main__":
    main()
