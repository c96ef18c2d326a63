"""The index of a corpus: clips.parquet, one row per clip. Takes of a sound share its file."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from talkingeyes.core.containers import read_parquet, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.file_name import FILE_NAME
from talkingeyes.core.settings import validate_record

SPLITS = ("train", "val", "test", "unseen")
FILE_COLUMNS = ("id", "sound", "speaker")
GIVEN_NAME = "speaker_name"  # the column of tracked corpora alone


@dataclass(frozen=True)
class Clip:
    """One take of one sound. `unseen` is the split of the speakers excluded from training.

    `speaker_name` is the name of the speaker as it was given to `track`; empty in other corpora.
    """

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
    speaker_name: str = ""


def write_index(path: Path, clips: Iterable[Clip]) -> None:
    """Write clips as parquet, in the order given."""
    table = pa.Table.from_pylist([asdict(clip) for clip in clips])
    pq.write_table(table if any(table[GIVEN_NAME].to_pylist()) else table.drop_columns(GIVEN_NAME), path)


def read_index(path: Path) -> list[Clip]:
    """Read clips.parquet. Raises InputError if it is missing, not parquet, lacks a column, or has an unsafe name."""
    required = [field.name for field in fields(Clip) if field.name != GIVEN_NAME]
    rows = read_parquet(path, required, "corpus index", optional=(GIVEN_NAME,))
    with reading(path, "corpus index"):
        clips = [validate_record(Clip, row) for row in rows]
    for clip in clips:
        if not (math.isfinite(clip.seconds) and clip.seconds > 0 and math.isfinite(clip.fps) and clip.fps > 0):
            raise InputError(f"{path}: seconds and fps should be above 0, got {clip.seconds} and {clip.fps}")
        for column in FILE_COLUMNS:
            if not FILE_NAME.fullmatch(name := str(getattr(clip, column))):
                raise InputError(f"{path}: {column} should be letters, digits, _ . + and -, got {name!r}")
    return clips
