"""Cache of animations until they are downloaded: one folder with a random name each, in the folder of the service."""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import HTTPException

NAME = re.compile("[0-9a-f]{32}")


@dataclass(frozen=True)
class CachedResult:
    """Name and folder of a cached animation."""

    name: str
    folder: Path


class ResultCache:
    """Keeps the newest animations."""

    def __init__(self, folder: Path, max_results: int) -> None:
        self._folder, self._max_results = folder, max_results
        self._entries: list[CachedResult] = []

    @contextmanager
    def entry(self) -> Iterator[CachedResult]:
        """A new folder, kept if the block succeeds; then the oldest entries are removed."""
        name = secrets.token_hex(16)
        entry = CachedResult(name, self._folder / name)
        entry.folder.mkdir()
        try:
            yield entry
        except BaseException:
            shutil.rmtree(entry.folder, ignore_errors=True)
            raise
        self._entries.append(entry)
        while len(self._entries) > self._max_results:
            shutil.rmtree(self._entries.pop(0).folder, ignore_errors=True)

    def find(self, name: str) -> Path:
        """The folder of an animation. Raises HTTPException (404) if it does not exist (any more)."""
        for entry in self._entries:
            if NAME.fullmatch(name) and entry.name == name:
                return entry.folder
        raise HTTPException(404, "no such animation; only the newest are kept")
