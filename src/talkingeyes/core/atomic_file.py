"""Writing of files: beside the target, then renamed; failures as errors of a command."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from talkingeyes.core.errors import InputError


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to `path` if the block succeeds."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
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
