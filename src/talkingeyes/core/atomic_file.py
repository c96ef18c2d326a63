"""Writing of files: beside the target, then renamed; failures as errors of a command."""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from talkingeyes.core.errors import InputError


def partial_path(path: Path) -> Path:
    """A hidden name beside `path` for this process. What killed processes have left under such names is removed."""
    _remove_left(path.parent, f".{glob.escape(path.name)}.*.partial")
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder that is removed at the end; those that killed processes have left are removed, too."""
    place = Path(tempfile.gettempdir())
    _remove_left(place, ".talkingeyes-*.partial")
    suffix = f".{os.getpid()}.partial"
    with tempfile.TemporaryDirectory(suffix, ".talkingeyes-", place, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def _remove_left(folder: Path, pattern: str) -> None:
    for left in folder.glob(pattern):
        maker = left.name.rsplit(".", 2)[1]
        if maker.isdigit() and not _runs(int(maker)):
            with contextlib.suppress(OSError):  # another process removes it, or it belongs to another user
                left.unlink() if left.is_file() else shutil.rmtree(left, ignore_errors=True)


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
