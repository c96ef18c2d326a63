"""CSV tables, plain or gzipped, with columns by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.containers import read_csv
from talkingeyes.core.errors import InputError


@dataclass(frozen=True)
class Table:
    """The rows of a file."""

    path: Path
    content: pa.Table

    def __len__(self) -> int:
        return int(self.content.num_rows)

    @property
    def names(self) -> list[str]:
        return [name.strip() for name in self.content.column_names]

    def column(self, name: str) -> Float[ndarray, " T"]:
        """Numbers of a column. Raises InputError if it is missing or holds anything else."""
        try:
            values = np.asarray(self._named(name).cast(pa.float64()).to_numpy(), np.float64)
        except (ValueError, pa.ArrowInvalid, pa.ArrowNotImplementedError):
            raise InputError(f"{self.path}: column {name} should hold numbers") from None
        if not np.isfinite(values).all():
            raise InputError(f"{self.path}: column {name} should hold finite numbers, got NaN or nothing in some rows")
        return values

    def texts(self, name: str) -> tuple[str, ...]:
        """Texts of a column."""
        return tuple(str(value) for value in self._named(name).to_pylist())

    def _named(self, name: str) -> pa.ChunkedArray:
        if name not in self.names:
            raise InputError(f"{self.path}: should have a column {name}, got {', '.join(self.names[:6])}, ...")
        return self.content.column(self.names.index(name))


def read(path: Path) -> Table:
    """Read a table; time codes stay texts. Raises InputError if it is unreadable or empty."""
    content = read_csv(path, text_columns=("Timecode", "approx_time"))
    if not content.num_rows:
        raise InputError(f"{path}: should have rows, got none")
    return Table(path, content)
