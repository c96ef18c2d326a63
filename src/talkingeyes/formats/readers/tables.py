"""CSV tables in any of their forms (csv_text.py), with columns by name."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float
from numpy import ndarray
from pyarrow import csv

from talkingeyes.core.containers import reading
from talkingeyes.core.errors import InputError
from talkingeyes.formats.csv_text import NOTHING, open_csv

LINE_END = "\r\n"


@dataclass(frozen=True)
class Table:
    """The rows of a file, as texts."""

    path: Path
    content: pa.Table
    decimal: str

    def __len__(self) -> int:
        return int(self.content.num_rows)

    @property
    def names(self) -> list[str]:
        return [name.strip() for name in self.content.column_names]

    def column(self, name: str) -> Float[ndarray, " T"]:
        """Numbers of a column, NaN where a cell has none. Raises InputError if it is missing or holds anything else."""
        texts = pc.utf8_trim(self._named(name), characters=' "')
        texts = pc.if_else(pc.is_in(texts, value_set=pa.array(NOTHING)), pa.scalar(None, pa.string()), texts)
        texts = pc.replace_substring(texts, ",", ".") if self.decimal == "," else texts
        try:
            values = np.asarray(texts.cast(pa.float64()).to_numpy(), np.float64)
        except pa.ArrowInvalid:
            raise InputError(f"{self.path}: column {name} should hold numbers") from None
        if np.isinf(values).any():
            raise InputError(f"{self.path}: column {name} should hold finite numbers, got infinite ones")
        return values

    def columns(self, *names: str, absent: float | None = None) -> Float[ndarray, "T C"]:
        """Columns side by side; `absent` is the value of one that the table lacks, which otherwise is an error."""
        return np.stack(
            [
                np.full(len(self), absent) if absent is not None and name not in self.names else self.column(name)
                for name in names
            ],
            axis=1,
        )

    def is_numeric(self, name: str) -> bool:
        """Whether a column holds numbers alone, and at least one."""
        try:
            return bool(np.isfinite(self.column(name)).any())
        except InputError:
            return False

    def texts(self, name: str) -> tuple[str, ...]:
        """Texts of a column."""
        return tuple(pc.utf8_trim(self._named(name), characters=' "').to_pylist())

    def _named(self, name: str) -> pa.ChunkedArray:
        if name not in self.names:
            raise InputError(f"{self.path}: should have a column {name}, got {', '.join(self.names[:6])}, ...")
        return self.content.column(self.names.index(name))


def read(path: Path) -> Table:
    """Read a table. Raises InputError if it is unreadable or has no rows."""
    table = open_csv(path)
    names, rows = table.names, table.rows
    if not rows:
        raise InputError(f"{path}: should have rows, got none")
    with reading(path, "CSV table"):
        whole = "".join(f"{_even(row.rstrip(LINE_END), len(names), table.delimiter)}\n" for row in rows)
        content = csv.read_csv(
            io.BytesIO(whole.encode()),
            csv.ReadOptions(column_names=names),
            csv.ParseOptions(delimiter=table.delimiter),
            csv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
    return Table(path, content, table.decimal)


def _even(row: str, width: int, delimiter: str) -> str:
    """A row with as many cells as there are names: short rows have none at the end, others end in a delimiter."""
    missing = width - 1 - row.count(delimiter)
    return row.removesuffix(delimiter) if missing < 0 else row + missing * delimiter
