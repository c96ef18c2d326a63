"""The index of a corpus: clips.parquet, one row per clip. Takes of a sound share its file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from talkingeyes.core.errors import InputError

SPLITS = ("train", "val", "test", "unseen")


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
    """Read clips.parquet. Raises InputError if it is missing, not parquet, or lacks a column."""
    try:
        table = pq.read_table(path, columns=[field.name for field in fields(Clip)])
    except (OSError, pa.ArrowInvalid, KeyError) as error:
        raise InputError(f"{path}: not a corpus index ({error})") from None
    return [Clip(**row) for row in table.to_pylist()]
