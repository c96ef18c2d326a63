"""Output folder of a command: checked before any work, and written atomically."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from talkingeyes.core.atomic_file import partial_path
from talkingeyes.core.errors import InputError


def output_path(out: Path, own_file_pattern: re.Pattern[str], force: bool) -> Path:
    """Check the output folder of a command.

    Raises InputError unless it is new, empty, or (with `force`) contains only files matching `own_file_pattern`.
    """
    try:
        folder = out.resolve()
        nearest = next(path for path in (folder, *folder.parents) if path.exists())
        found = sorted(path.name for path in nearest.iterdir()) if nearest == folder else []
    except (OSError, ValueError) as error:  # ValueError: a NUL character
        raise InputError(f"{str(out)!r}: should be a new or empty folder, got: {error}") from None
    strange = [name for name in found if not own_file_pattern.fullmatch(name)]
    if strange:
        raise InputError(f"{out}: should be a new or empty folder, or earlier output, got one with {strange[0]} in it")
    if found and not force:
        raise InputError(f"{out}: should be a new or empty folder, got one with earlier output; --force replaces it")
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise InputError(f"{out}: should be in a writable folder, got {nearest}")
    return folder


@contextlib.contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder beside the target, which replaces the target if the block succeeds."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(folder)
    try:
        partial.mkdir()
        yield partial
        replace_folder(folder, partial)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def replace_folder(folder: Path, by: Path) -> None:
    """Move a folder to the place of another, which is never there in part."""
    former = partial_path(folder.with_name(f"{folder.name}.former"))
    if os.path.lexists(folder):
        folder.rename(former)
    by.rename(folder)
    if former.is_symlink():
        former.unlink()
    shutil.rmtree(former, ignore_errors=True)
