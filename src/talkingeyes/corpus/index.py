"""The index of a corpus: clips.parquet, one row per clip. Takes of a sound share its file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from talkingeyes.core.containers import read_parquet
from talkingeyes.core.errors import InputError

SPLITS = ("train", "val", "test", "unseen")
# These become names of files: no separators, no leading dot.
FILE_NAME = re.compile(r"\w[\w.+-]*")
FILE_COLUMNS = ("id", "sound", "speaker")


@dataclass(frozen=True)
class Clip:
    """One take of one sound. `unseen` is the split of the speakers excluded from training."""

    id: str
    sound: str
    take: int
    speaker: str
    split: str
    seconds: float
    fps: float
    emotion: str
    intensity: int
    language: str
    text: str
    source: str
    licence: str
    content_hash: str


def write_index(path: Path, clips: Iterable[Clip]) -> None:
    """Write clips as parquet, in the order given."""
    pq.write_table(pa.Table.from_pylist([asdict(clip) for clip in clips]), path)


def read_index(path: Path) -> list[Clip]:
    """Read clips.parquet. Raises InputError if it is missing, not parquet, lacks a column, or has an unsafe name."""
    clips = [Clip(**row) for row in read_parquet(path, [field.name for field in fields(Clip)], "corpus index")]
    for clip in clips:
        for column in FILE_COLUMNS:
            if not FILE_NAME.fullmatch(name := str(getattr(clip, column))):
                raise InputError(f"{path}: {column} should be letters, digits, _ . + and -, got {name!r}")
    return clips
