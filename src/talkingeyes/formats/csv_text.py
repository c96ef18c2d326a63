"""The text of a CSV table and the form in which a program or a spreadsheet wrote it.

UTF-8 or UTF-16 with or without a byte order mark, otherwise Latin-1; commas, semicolons, tabs or bars between cells;
0.5 or 0,5; plain or gzipped; with the line `sep=;` of spreadsheets before the names, or without.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from talkingeyes.core.containers import MAX_COLUMNS, MAX_TABLE_BYTES, read_bytes, reading
from talkingeyes.core.errors import InputError

MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
MARK = "\ufeff"
DELIMITERS = ",;\t|"
SEPARATOR_LINE = re.compile(rf"sep=([{DELIMITERS}])\s*")
NOTHING = ("", "nan", "NaN", "-nan", "-nan(ind)", "NA", "N/A", "null", "None")  # in a cell without a number
CELL = re.compile(r'^([ \t]*"?[ \t]*).*?(\s*"?\s*)$', re.DOTALL)
DECIMAL = re.compile(r"[-+]?\d*([.,])\d+(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class CsvText:
    """Lines of a table with their ends, the first with the mark of its encoding; `lines[header]` names the columns."""

    path: Path
    encoding: str
    lines: list[str]
    header: int
    delimiter: str
    decimal: str = "."

    @property
    def names(self) -> list[str]:
        """The names of the columns, without quotes."""
        return next(self._cells([self.lines[self.header].lstrip(MARK)]))

    @property
    def rows(self) -> list[str]:
        """The lines of the rows."""
        return [line for line in self.lines[self.header + 1 :] if line.strip()]

    def encoded(self, lines: list[str]) -> bytes:
        """The content of the file with other lines."""
        content = "".join(lines).encode(self.encoding)
        return gzip.compress(content, mtime=0) if self.path.suffix.lower() == ".gz" else content

    def raw_cells(self, line: str) -> list[str]:
        """The cells of a line as they are written, the last one with the end of the line."""
        if '"' not in line:
            return line.split(self.delimiter)
        end = re.escape(self.delimiter)
        return re.findall(rf'((?:"[^"]*"|[^"{end}])*){end}', line + self.delimiter)

    def number(self, raw: str) -> float:
        """The number in a raw cell, NaN if it has none. Raises InputError (one line) for another text."""
        text = raw.strip(' "\t\r\n').replace(self.decimal, ".")
        try:
            return float("nan" if text in NOTHING else text)
        except ValueError:
            raise InputError(f"{self.path}: cells should hold numbers, got {text!r}") from None

    def with_number(self, raw: str, number: str) -> str:
        """A raw cell with another number in its quotes and spaces; `number` has a decimal point."""
        written = number.replace(".", self.decimal)
        if self.delimiter in written and '"' not in raw:
            written = f'"{written}"'
        return CELL.sub(lambda parts: f"{parts[1]}{written}{parts[2]}", raw, count=1)

    def with_decimal(self) -> CsvText:
        """The table with the decimal sign of the first cell that has one."""
        found = (DECIMAL.fullmatch(cell.strip()) for row in self._cells(self.rows) for cell in row)
        return replace(self, decimal=next((match[1] for match in found if match), "."))

    def _cells(self, lines: list[str]) -> Iterator[list[str]]:
        return csv.reader(lines, delimiter=self.delimiter, skipinitialspace=True)


def open_csv(path: Path) -> CsvText:
    """Open a table. Raises InputError (one line) if it is too large or has no line of names."""
    with reading(path, "CSV table"):
        content = read_bytes(path, MAX_TABLE_BYTES)
        content = _inflated(content) if path.suffix.lower() == ".gz" else content
        encoding = encoding_of(content)
        lines = list(io.StringIO(content.decode(encoding), newline=""))
        header = next(k for k, line in enumerate(lines) if line.strip(f"{MARK} \r\n"))
        stated = SEPARATOR_LINE.fullmatch(lines[header].lstrip(MARK))
        names = lines[header + 1] if stated else lines[header]
        delimiter = stated[1] if stated else max(DELIMITERS, key=re.sub('"[^"]*"', "", names).count)
        if names.count(delimiter) >= MAX_COLUMNS:
            raise ValueError(f"should have at most {MAX_COLUMNS:,} columns, got {names.count(delimiter) + 1:,}")
        return CsvText(path, encoding, lines, header + bool(stated), delimiter).with_decimal()


def encoding_of(content: bytes) -> str:
    """The encoding of a text; one with a mark is decoded with it, as the first letter."""
    for mark, encoding in MARKS.items():
        if content.startswith(mark):
            return encoding
    if 0 in content[:2]:  # letters of a name in two bytes each
        return "utf-16-be" if content[0] == 0 else "utf-16-le"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def _inflated(content: bytes) -> bytes:
    with gzip.open(io.BytesIO(content)) as file:
        inflated = file.read(MAX_TABLE_BYTES + 1)
    if len(inflated) > MAX_TABLE_BYTES:
        raise ValueError(f"should have at most {MAX_TABLE_BYTES:,} bytes")
    return inflated
