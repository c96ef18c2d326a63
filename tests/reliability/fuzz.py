"""Damage files of every kind and give them to the command line: `make reliability`, docs/reliability.md.

A case passes if the command succeeds, or ends with status 2 and one line of at most MAX_LINE letters on stderr, within
TIME_S and MEMORY_MIB, and has written nothing, started no program and connected to nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from command_line import call
from fuzz_targets import Target, targets, write_good_files
from joblib import Parallel, delayed
from mutations import mutate
from tqdm import tqdm

MAX_LINE, TIME_S, MEMORY_MIB = 300, 10, 1024
ADDRESSES = 16 * 2**30  # bytes: a case that asks for more ends before the machine does
WAIT_S = 90  # for a case, on a busy machine
CASES = Path("../shared/data/cases")  # files of other programs, where there are some
FORBIDDEN = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "os.fork")
PROGRESS = re.compile(r"\d%\||it/s\]|s/it\]")  # bars of tqdm
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Slow(BaseException):
    """Not an Exception: nothing that reads a file may catch it."""


class Watch:
    """An audit hook that notes what a command does besides reading files and writing below `place`."""

    def __init__(self, place: Path) -> None:
        self.allowed, self.done, self.on = (f"{place}/", "/dev/", tempfile.gettempdir()), [], False
        sys.addaudithook(self._heard)

    def _heard(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in FORBIDDEN:
            self.done.append(event)
        elif event == "open" and isinstance(arguments[0], str) and isinstance(arguments[2], int):
            path = os.path.abspath(arguments[0])
            allowed = path.startswith(self.allowed) or path.endswith(".pyc")
            if arguments[2] & WRITING and ("canary" in path or not (allowed or ".pyc." in path)):
                self.done.append(f"wrote {path}")


def judge(target: Target, place: Path, watch: Watch, good: bool = False) -> str | None:
    """What is wrong with the behaviour of the command, or None; a good file should be read."""
    text = (
        (place / target.file).read_bytes().decode("utf-8", "replace").replace("\0", "")
        if "{text}" in target.words
        else ""
    )
    words = [word.replace("{file}", target.file).replace("{text}", text) for word in target.words.split()]
    said, told = io.StringIO(), io.StringIO()
    signal.setitimer(signal.ITIMER_PROF, TIME_S)
    watch.on, status, fault = True, 0, None
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(told):
            status = call(*words)
    except Slow:
        fault = f"more than {TIME_S} CPU s"
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__}: {str(error)[:80]} ({Path(last.filename).name}:{last.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        watch.on = False
    written = [path for path in place.iterdir() if path.name.startswith(("out", ".out", "canary"))]
    lines = [line for line in re.split(r"[\r\n]", said.getvalue()) if line.strip() and not PROGRESS.search(line)]
    if fault is None and status not in (0, 2):
        fault = f"status {status}: {lines[-1][:120] if lines else ''}"
    elif fault is None and status == 2:
        if good:
            fault = f"refused: {lines[0] if lines else 'nothing said'}"
        elif len(lines) != 1 or not lines[0].startswith("error: "):
            fault = f"{len(lines)} lines: {' / '.join(lines)[:160]}"
        elif len(lines[0]) > MAX_LINE:
            fault = f"a line of {len(lines[0])} letters"
        elif written:
            fault = f"left {written[0].name}"
    if watch.done:
        fault = watch.done[0]
        watch.done.clear()
    for path in written:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return fault


def _peak_mib() -> int:
    """Most memory that this process has held."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) // 1024 for line in lines if line.startswith("VmHWM"))


def _batch(target: Target, good: Path, place: Path, numbers: Sequence[int], seed: int, results: Connection) -> None:
    """Run cases in this process, which is a child and may die; sends (number, fault) each."""
    os.chdir(place)
    if not os.environ.get("FUZZ_SHOW"):
        silent = os.open(os.devnull, os.O_WRONLY)  # of libraries that print without asking Python
        os.dup2(silent, 1), os.dup2(silent, 2)

    def stop(*_: object) -> None:
        raise Slow

    signal.signal(signal.SIGPROF, stop)
    content, watch = (good / target.file).read_bytes(), Watch(place)
    fault = judge(target, place, watch, good=True)  # the good file: imports what the command needs
    if fault:
        results.send((-1, f"the good file: {fault}"))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES,) * 2)
    for number in numbers:
        damaged = mutate(content, target.form, np.random.default_rng([seed, number]))
        (place / target.file).write_bytes(damaged)
        results.send((number, "died"))  # what holds if this process says no more
        Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
        before = _peak_mib()
        fault = judge(target, place, watch)
        if _peak_mib() - before > MEMORY_MIB:
            fault = f"{_peak_mib() - before} MiB"
        results.send((number, fault))
        (place / target.file).write_bytes(content)
    results.send(None)


def fuzz(target: Target, good: Path, count: int, seed: int, keep: Path | None) -> dict[int, str]:
    """Faults by number of the case; a child that dies or hangs is replaced."""
    faults: dict[int, str] = {}
    todo, context = list(range(count)), multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory(prefix="talkingeyes-fuzz-") as folder:
        place = Path(folder) / "files"
        shutil.copytree(good, place)
        while todo:
            before = len(todo)
            here, there = context.Pipe(duplex=False)
            child = context.Process(target=_batch, args=(target, good, place, todo, seed, there))
            child.start()
            there.close()
            finished = False
            with contextlib.suppress(EOFError):
                while here.poll(WAIT_S):
                    said = here.recv()
                    if said is None:
                        finished = True
                        break
                    number, fault = said
                    faults.pop(number, None)
                    if fault:
                        faults[number] = fault
                    todo = [each for each in todo if each > number]
            if not finished:
                child.kill()
            child.join()
            if not finished and len(todo) == before:
                faults[-1] = "the good file: the process died"
                break
            shutil.copytree(good, place, dirs_exist_ok=True)
            if finished or not todo:
                break
    if keep is not None:
        content = (good / target.file).read_bytes()
        for number in sorted(faults)[:3]:
            name = f"{target.name.replace('/', '_')}-{number}{Path(target.file).suffix}"
            (keep / name).write_bytes(
                mutate(content, target.form, np.random.default_rng([seed, number])) if number >= 0 else content
            )
    return faults


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all targets; prints faults, then how many of each kind were tried and failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=300, help="for each kind of file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--keep", type=Path, help="a folder for files that fail")
    given = parser.parse_args(arguments)
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="talkingeyes-good-") as folder:
        good = Path(folder)
        cases = (
            sorted(
                path
                for path in CASES.glob("*.*")
                if path.suffix in (".csv", ".glb", ".json") and "no-target-names" not in path.name
            )
            if CASES.is_dir()
            else []
        )
        write_good_files(good, cases)
        wanted = [each for each in targets([path.name for path in cases]) if given.only in each.name]
        tasks = (delayed(fuzz)(each, good, given.mutations, given.seed, given.keep) for each in wanted)
        found = Parallel(n_jobs=given.jobs, return_as="generator")(tasks)
        failed = list(report(wanted, tqdm(found, total=len(wanted), disable=None), given.mutations))
    tried, faults = Counter[str](), Counter[str]()
    for target, number in zip(wanted, failed, strict=True):
        kind = f"{target.name.split()[0]}, {target.form}"
        tried[kind] += given.mutations
        faults[kind] += number
    print("\nby command and form of its file")
    for kind, count in tried.items():
        print(f"{kind:32} {count} tried, {faults[kind]} failed")
    total, failures = tried.total(), faults.total()
    print(f"{total} tried, {failures} failed ({failures / max(total, 1):.2%}), seed {given.seed}")
    sys.exit(1 if failures else 0)


def report(wanted: Sequence[Target], found: Iterator[dict[int, str]], tried: int) -> Iterator[int]:
    """Print the faults of each kind of file; yields their number."""
    for target, faults in zip(wanted, found, strict=True):
        print(f"{target.name:32} {tried} tried, {len(faults)} failed")
        for said, number in Counter(faults.values()).most_common(5):
            first = min(case for case, fault in faults.items() if fault == said)
            print(f"    {number} x {said}  (first: {first})", flush=True)
        yield len(faults)


if __name__ == "__main__":
    main()
