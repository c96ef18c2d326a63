"""Where performances lie until they are fetched: a folder each, named here, in the one folder of the service."""

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
    """A performance by name, and its folder."""

    name: str
    folder: Path


class ResultCache:
    """The performances that are kept: the newest ones."""

    def __init__(self, folder: Path, max_results: int) -> None:
        self._folder, self._max_results = folder, max_results
        self._entries: list[CachedResult] = []

    @contextmanager
    def entry(self) -> Iterator[CachedResult]:
        """A new folder, kept if the block ends well; the oldest one goes then."""
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
        """The folder of a performance. Raises HTTPException (404) for what is not, or no longer, there."""
        for entry in self._entries:
            if NAME.fullmatch(name) and entry.name == name:
                return entry.folder
        raise HTTPException(404, "no such performance, or no longer: the newest are kept")
