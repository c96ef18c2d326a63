"""The result store: stage outputs in folders named by a hash of all their dependencies, so that nothing runs twice.

    <store>/<stage>[-<item>]-<key>/output/            the stage's folder, as it would be in data/
    <store>/<stage>[-<item>]-<key>/provenance.json    its inputs, its files, the report of the stage

The key is a hash of the config sections that the stage reads, the keys of its inputs and the code that it imports, all
as declared in dvc.yaml (stage_graph.py). A stage runs in a folder that contains only links to its declared inputs, so
it cannot read anything undeclared. An entry appears atomically, by a rename, under a lock: if two processes need the
same entry, one creates it and the other waits. Results of `dvc repro` are reused if dvc.lock shows that they are the
same.

The store has no expiry and no index. Any folder in it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from talkingeyes.core.errors import InputError
from talkingeyes.orchestration.run import CHECKSUMS_FILE, MethodResult, Report, Workspace
from talkingeyes.orchestration.stage_graph import DEFAULT_CORPUS, REPOSITORY_ROOT, StageCall, get_section

KEY_LENGTH = 16
# Sections available to every stage besides its own: the path of the corpus, and the machine, which changes no result.
IMPLICIT_SECTIONS = ("corpus", "machine")

# Machine settings that change rounding in training; `dvc repro` ignores them.
ROUNDING_KEYS = ("device", "precision")

StageRunner = Callable[[StageCall, Workspace], Report]


@dataclass(frozen=True)
class StoredResult:
    """One result in the store. `origin` is how it was obtained this time: made, store or dvc."""

    folder: Path
    key: str
    report: Report
    origin: str

    @property
    def output(self) -> Path:
        """The output folder of the stage."""
        return self.folder / "output"


def get_or_run(
    store: Path,
    call: StageCall,
    params: Mapping[str, Any],
    upstream: Mapping[Path, StoredResult],
    make: StageRunner,
    checkout: Path = REPOSITORY_ROOT,
) -> StoredResult:
    """The result of a call: from the store, from data/ of the checkout if it is the same, or newly computed.

    `upstream` holds the results of all calls before it, by their folders under data/.
    """
    from filelock import FileLock

    read = {folder: entry for folder, entry in upstream.items() if _reads(call, folder)}
    made_from = _made_from(call, params, read, checkout)
    key = hashlib.sha256(_canonical(made_from).encode()).hexdigest()[:KEY_LENGTH]
    folder = store / "-".join(filter(None, (call.stage, call.item, key)))
    store.mkdir(parents=True, exist_ok=True)
    with FileLock(store / f".{folder.name}.lock"):
        if folder.exists():
            damage = _damage(folder)
            if damage is None:
                return StoredResult(folder, key, _report_of(folder), "store")
            print(f"store: {folder.name} is damaged ({damage}); it is recreated", file=sys.stderr)
            shutil.rmtree(folder)
        making = store / f".{folder.name}.partial"
        own = _dvc_output(call, params, read, checkout)
        if own is not None:
            _copy(own, making / call.folder)
            report = Report()
        else:
            report = _make(call, params, read, making, make)
        _keep(making, call, folder, made_from, report)
        shutil.rmtree(making)
        return StoredResult(folder, key, _report_of(folder), "made" if own is None else "dvc")


def link_output(entry: StoredResult, path: Path) -> None:
    """Link an entry into a workspace's data/, replacing what was there."""
    if path.is_symlink() or not path.is_dir():
        path.unlink(missing_ok=True)
    else:
        shutil.rmtree(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(entry.output.resolve())


def code_version(paths: Sequence[str], checkout: Path = REPOSITORY_ROOT) -> dict[str, str]:
    """A hash of each package or file."""
    return {path: _code_md5(checkout / path) for path in paths}


def dvc_md5(path: Path) -> str:
    """The hash that DVC computes for a file or a folder, for comparison with dvc.lock."""
    if path.is_file():
        return hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest()
    files = [each for each in sorted(path.rglob("*")) if each.is_file() and "__pycache__" not in each.parts]
    tree = [{"md5": dvc_md5(each), "relpath": each.relative_to(path).as_posix()} for each in files]
    tree.sort(key=lambda each: each["relpath"])  # sorted as text: sub.x before sub/x
    return hashlib.md5(json.dumps(tree, sort_keys=True).encode(), usedforsecurity=False).hexdigest() + ".dir"


_code_md5 = cache(dvc_md5)  # code does not change while a process runs


def _reads(call: StageCall, folder: Path) -> bool:
    return any(Path(each).is_relative_to(folder) or folder.is_relative_to(each) for each in call.inputs)


def _made_from(
    call: StageCall, params: Mapping[str, Any], read: Mapping[Path, StoredResult], checkout: Path
) -> dict[str, Any]:
    found = {
        "stage": call.address,
        "sections": {key: get_section(params, key) for key in call.sections},
        "reads": {folder.as_posix(): entry.key for folder, entry in sorted(read.items())},
        "code": code_version(call.code_deps, checkout),
    }
    if any("training" in each for each in call.code_deps):
        found["rounding"] = {key: params["machine"].get(key) for key in ROUNDING_KEYS}
    corpus = str(params["corpus"])
    if corpus != DEFAULT_CORPUS and any(Path(each).is_relative_to(corpus) for each in call.inputs):
        index = Path(corpus, "clips.parquet")  # contains a hash of each clip
        if not index.is_file():
            raise InputError(f"corpus: {corpus} should be a folder with clips.parquet")
        found["corpus"] = dvc_md5(index)
    return found


def _make(
    call: StageCall, params: Mapping[str, Any], read: Mapping[Path, StoredResult], making: Path, make: StageRunner
) -> Report:
    """Run the stage in a folder with only its declared inputs. It may resume from what a killed run left there."""
    seen: dict[str, Any] = {key: params[key] for key in IMPLICIT_SECTIONS}
    for key in call.sections:
        node = seen
        for part in key.split(".")[:-1]:
            node = node.setdefault(part, {})
        node[key.split(".")[-1]] = get_section(params, key)
    for folder, entry in read.items():
        link_output(entry, making / folder)
    try:
        return make(call, Workspace(making.resolve(), seen))
    except Exception:
        shutil.rmtree(making, ignore_errors=True)
        raise


def _keep(making: Path, call: StageCall, folder: Path, made_from: Mapping[str, Any], report: Report) -> None:
    """Move an output into the store: assemble the entry beside it, then rename it."""
    output, whole = making / call.folder, making / "entry"
    shutil.rmtree(whole, ignore_errors=True)
    whole.mkdir()
    content = {**made_from, "files": _stamps(output), "report": _plain(report, output)}
    (whole / "provenance.json").write_text(json.dumps(content, indent=1))
    output.rename(whole / "output")
    whole.rename(folder)


def _plain(report: Report, output: Path) -> dict[str, Any]:
    """A report with file names relative to the output."""

    def names(paths: Sequence[Path]) -> list[str]:
        return [path.resolve().relative_to(output.resolve()).as_posix() for path in paths]

    rows = [{**asdict(row), "artifacts": names(row.artifacts)} for row in report.rows]
    return {"metrics": dict(report.metrics), "artifacts": names(report.artifacts), "rows": rows}


def _report_of(folder: Path) -> Report:
    plain = json.loads((folder / "provenance.json").read_text())["report"]

    def paths(names: Sequence[str]) -> list[Path]:
        return [folder / "output" / name for name in names]

    rows = [MethodResult(**{**row, "artifacts": paths(row["artifacts"])}) for row in plain["rows"]]
    return Report(plain["metrics"], paths(plain["artifacts"]), rows)


def _stamps(output: Path) -> dict[str, list[int]]:
    """Size and modification time of every file; if both are unchanged, so is the content."""
    files = sorted(path for path in output.rglob("*") if path.is_file())
    return {path.relative_to(output).as_posix(): _stamp(path) for path in files}


def _stamp(path: Path) -> list[int]:
    found = path.stat()
    return [found.st_size, found.st_mtime_ns]


def _damage(folder: Path) -> str | None:
    """Description of damage in an entry, or None. A file with another time is read and compared with SHA256SUMS."""
    output = folder / "output"
    try:
        stamps = json.loads((folder / "provenance.json").read_text())["files"]
        lines = [line.split("  ", 1) for line in (output / CHECKSUMS_FILE).read_text().splitlines()]
        sums = {name: sum_ for sum_, name in lines}
    except (OSError, ValueError, KeyError) as error:
        return f"{type(error).__name__} in provenance.json or {CHECKSUMS_FILE}"
    for name, stamp in stamps.items():
        path = output / name
        if not path.is_file():
            return f"{name} is missing"
        if (
            _stamp(path) != stamp
            and name != CHECKSUMS_FILE
            and hashlib.sha256(path.read_bytes()).hexdigest() != sums.get(name)
        ):
            return f"{name} does not match {CHECKSUMS_FILE}"
    return None


def _dvc_output(
    call: StageCall, params: Mapping[str, Any], read: Mapping[Path, StoredResult], checkout: Path
) -> Path | None:
    """The folder in data/ that `dvc repro` made from identical dependencies, or None.

    dvc.lock holds the values and hashes of all dependencies and outputs.
    """
    output = checkout / call.folder
    lock = checkout / "dvc.lock"
    stages = _locked(lock, lock.stat().st_mtime_ns) if lock.is_file() else {}
    if call.address not in stages or not (output / CHECKSUMS_FILE).is_file():
        return None
    locked = stages[call.address]
    values = locked.get("params", {}).get("params.yaml", {})
    if values != {key: get_section(params, key) for key in call.sections}:
        return None
    places = {each["path"]: each.get("md5") for each in locked.get("deps", [])}
    here = {path: dvc_md5(_inside(read, path)) for path in call.inputs} | code_version(call.code_deps, checkout)
    outs = {each["path"]: each.get("md5") for each in locked.get("outs", [])}
    # Last, because it reads the whole output.
    return output if here == places and outs == {call.folder.as_posix(): dvc_md5(output)} else None


@lru_cache(maxsize=1)
def _locked(lock: Path, changed_ns: int) -> dict[str, Any]:
    """The stages of dvc.lock, parsed again after a change. Uses DVC's parser, because PyYAML reads its 1e-06 as a
    string."""
    return dict(YAML(typ="safe").load(lock.read_text())["stages"])


def _inside(read: Mapping[Path, StoredResult], path: str) -> Path:
    """Path of a declared dependency in the store."""
    for folder, entry in read.items():
        if Path(path).is_relative_to(folder):
            return entry.output / Path(path).relative_to(folder)
    return Path(path)


def _copy(source: Path, target: Path) -> None:
    """Copy by hard links where possible, to save space; outputs are never modified in place."""

    def place(one: str, other: str) -> None:
        try:
            os.link(one, other)
        except OSError:
            shutil.copy2(one, other)

    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, copy_function=place)


def _canonical(node: Any) -> str:
    return json.dumps(node, sort_keys=True)
