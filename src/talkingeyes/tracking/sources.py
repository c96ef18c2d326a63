"""Videos to track: their names in the corpus, and their speakers.

A video is named by its path below the given folder, so the corpus contains no absolute paths. Its speaker is the first
folder of that path (as in VoxCeleb2), else the video is a speaker of its own; a map file overrides both.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from talkingeyes.core.containers import read_text
from talkingeyes.core.errors import InputError
from talkingeyes.tracking.video import SUFFIXES


@dataclass(frozen=True)
class VideoSource:
    """A video: its path, name in the corpus, prefix of its clip ids, and speaker."""

    path: Path
    name: str
    id: str
    speaker: str


def find_videos(videos: Sequence[Path], speakers: Path | None) -> list[VideoSource]:
    """All videos in files and folders, by name. Raises InputError for none, duplicate names, or a bad map."""
    named = _named(videos)
    if not named:
        raise InputError(f"videos: should be files or folders with videos ({' '.join(SUFFIXES)}), got none")
    known = {} if speakers is None else _read_map(speakers)
    missing = next((name for name in named if speakers is not None and name not in known), None)
    if missing is not None:
        raise InputError(f"{speakers}: should name the speaker of every video, got none for {missing}")
    return [
        VideoSource(path, name, _id(name), known.get(name) or _speaker(name)) for name, path in sorted(named.items())
    ]


def _named(videos: Sequence[Path]) -> Mapping[str, Path]:
    named: dict[str, Path] = {}
    for given in videos:
        if given.is_dir():
            found = sorted(path for path in given.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
            below = {path.relative_to(given).as_posix(): path for path in found}
        elif given.is_file():
            below = {given.name: given}
        else:
            raise InputError(f"{given}: should be a video or a folder of videos, got nothing there")
        for name, path in below.items():
            if named.setdefault(name, path).resolve() != path.resolve():
                raise InputError(f"{path}: name should be unique, got another video {name}; name a folder above both")
    return named


def _id(name: str) -> str:
    """A name that is valid for files, plus six digits of a hash to keep it unique."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "-", name.rsplit(".", 1)[0]).strip("-")[-48:]
    return f"{plain}-{hashlib.blake2b(name.encode(), digest_size=3).hexdigest()}"


def _speaker(name: str) -> str:
    first, slash, _ = name.partition("/")
    return first if slash else name.rsplit(".", 1)[0]


def _read_map(path: Path) -> dict[str, str]:
    text = read_text(path, "CSV with the columns video and speaker")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
        return {row["video"]: row["speaker"] for row in rows if row["speaker"]}
    except (KeyError, csv.Error) as error:
        raise InputError(f"{path}: should be a CSV with the columns video and speaker, got: {error!r}") from None
