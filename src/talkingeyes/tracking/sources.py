"""Videos to track: their names in the corpus, and their speakers.

A video is named by its path below the given folder, so the corpus contains no absolute paths. Its speaker is the first
folder of that path (as in VoxCeleb2), else the video is a speaker of its own; a map file overrides both. In the corpus
a speaker's name is a name of files: one that cannot be is made valid and unique, and kept as given beside it.
"""

from __future__ import annotations

import csv
import io
import os
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from talkingeyes.core.containers import read_text
from talkingeyes.core.errors import InputError
from talkingeyes.core.file_name import FILE_NAME, unique_file_name
from talkingeyes.tracking.video import SUFFIXES


@dataclass(frozen=True)
class VideoSource:
    """A video: its path, name in the corpus, prefix of its clip ids, and speaker, by a valid name and as given."""

    path: Path
    name: str
    id: str
    speaker: str
    speaker_name: str


def find_videos(videos: Sequence[Path], speakers: Path | None) -> list[VideoSource]:
    """All videos in files and folders, by name. Raises InputError for none, duplicate names, or a bad map."""
    named = _named(videos)
    if not named:
        raise InputError(f"videos: should be files or folders with videos ({' '.join(SUFFIXES)}), got none")
    known = {} if speakers is None else _read_map(speakers)
    missing = next((name for name in named if speakers is not None and _composed(name) not in known), None)
    if missing is not None:
        raise InputError(f"{speakers}: should name the speaker of every video, got none for {missing}")
    return [
        _source(path, name, known.get(_composed(name)) or _speaker_name(name)) for name, path in sorted(named.items())
    ]


def _source(path: Path, name: str, speaker_name: str) -> VideoSource:
    is_valid = FILE_NAME.fullmatch(speaker_name)
    speaker = speaker_name if is_valid else unique_file_name(speaker_name, speaker_name)
    return VideoSource(path, name, unique_file_name(name.rsplit(".", 1)[0], name), speaker, speaker_name)


def _named(videos: Sequence[Path]) -> Mapping[str, Path]:
    named: dict[str, Path] = {}
    for given in videos:
        if given.is_dir():
            found = sorted(path for path in given.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
            below = {_printable(path.relative_to(given).as_posix()): path for path in found}
        elif given.is_file():
            below = {_printable(given.name): given}
        else:
            raise InputError(f"{given}: should be a video or a folder of videos, got nothing there")
        for name, path in below.items():
            if named.setdefault(name, path).resolve() != path.resolve():
                raise InputError(f"{path}: name should be unique, got another video {name}; name a folder above both")
    return named


def _printable(name: str) -> str:
    """The name with the bytes that are not UTF-8 (of old archives) written as escapes."""
    return os.fsencode(name).decode(errors="backslashreplace")


def _composed(name: str) -> str:
    """The name by which a map is searched: macOS writes an umlaut as two characters, keyboards as one."""
    return unicodedata.normalize("NFC", name)


def _speaker_name(name: str) -> str:
    first, slash, _ = name.partition("/")
    return first if slash else name.rsplit(".", 1)[0]


def _read_map(path: Path) -> dict[str, str]:
    text = read_text(path, "CSV with the columns video and speaker")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
        return {_composed(row["video"]): row["speaker"] for row in rows if row["speaker"]}
    except (KeyError, csv.Error) as error:
        raise InputError(f"{path}: should be a CSV with the columns video and speaker, got: {error!r}") from None
