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
class Place:
    """A performance by name, and its folder."""

    name: str
    folder: Path


class Shelf:
    """The performances that are kept: the newest ones."""

    def __init__(self, folder: Path, kept: int) -> None:
        self._folder, self._kept = folder, kept
        self._whole: list[Place] = []

    @contextmanager
    def place(self) -> Iterator[Place]:
        """A new folder, kept if the block ends well; the oldest one goes then."""
        name = secrets.token_hex(16)
        place = Place(name, self._folder / name)
        place.folder.mkdir()
        try:
            yield place
        except BaseException:
            shutil.rmtree(place.folder, ignore_errors=True)
            raise
        self._whole.append(place)
        while len(self._whole) > self._kept:
            shutil.rmtree(self._whole.pop(0).folder, ignore_errors=True)

    def find(self, name: str) -> Path:
        """The folder of a performance. Raises HTTPException (404) for what is not, or no longer, there."""
        for place in self._whole:
            if NAME.fullmatch(name) and place.name == name:
                return place.folder
        raise HTTPException(404, "no such performance, or no longer: the newest are kept")
