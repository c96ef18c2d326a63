"""Writing of files: beside the target, then renamed; failures as errors of a command."""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from talkingeyes.core.errors import InputError


def partial_path(path: Path) -> Path:
    """A hidden name beside `path` for this process. What killed processes have left under such names is removed."""
    if path.parent.is_dir():
        for left in path.parent.glob(f".{glob.escape(path.name)}.*.partial"):
            maker = left.name.rsplit(".", 2)[1]
            if maker.isdigit() and not _runs(int(maker)):
                left.unlink() if left.is_file() else shutil.rmtree(left, ignore_errors=True)
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to `path` if the block succeeds."""
    partial = partial_path(path)
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def writing(target: Path | str, kind: str = "file") -> Iterator[None]:
    """Raise InputError (one line) if the block cannot write the file or folder of a command."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{target}: should be a {kind} that can be written, got: {error.strerror or error}") from None
