"""The text of a CSV table and the form in which a program or a spreadsheet wrote it.

UTF-8 or UTF-16 with or without a byte order mark, otherwise Latin-1; commas, semicolons, tabs or bars between cells;
0.5 or 0,5; plain or gzipped. Before the names may stand the line `sep=;` of spreadsheets, and lines of few cells (a
title, comments); after the rows, lines of empty cells.
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
TITLE_LINES = 20  # at most, before the names
_NOTHING = "nan -nan -nan(ind) -1.#IND 1.#QNAN NA N/A n/a null NULL None - #N/A #NV #DIV/0! #NUM! #VALUE! #WERT!"
NOTHING = ("", "NaN", *_NOTHING.split())  # in a cell without a number
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
        """The names of the columns, without quotes; numpy writes `#` before them."""
        return next(self._cells([self.lines[self.header].lstrip(f"{MARK}# ")]))

    @property
    def row_lines(self) -> list[int]:
        """Where the rows stand among the lines; those of empty cells at the end, which spreadsheets write, are none."""
        empty = f'{self.delimiter}" \r\n'
        last = max((k for k, line in enumerate(self.lines) if line.strip(empty)), default=0)
        return [k for k, line in enumerate(self.lines[: last + 1]) if k > self.header and line.strip()]

    @property
    def rows(self) -> list[str]:
        """The lines of the rows."""
        return [self.lines[k] for k in self.row_lines]

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
        plain = [(k, line.lstrip(MARK)) for k, line in enumerate(lines) if line.strip(f"{MARK} \r\n")]
        stated = next((match for _, line in plain[:1] if (match := SEPARATOR_LINE.fullmatch(line))), None)
        header, names = _line_of_names(plain[bool(stated) :])
        delimiter = stated[1] if stated else _delimiter(names)
        if names.count(delimiter) >= MAX_COLUMNS:
            raise ValueError(f"should have at most {MAX_COLUMNS:,} columns, got {names.count(delimiter) + 1:,}")
        return CsvText(path, encoding, lines, header, delimiter).with_decimal()


def _line_of_names(lines: list[tuple[int, str]]) -> tuple[int, str]:
    """The first of some lines with their places that has at least half as many cells as the widest."""
    if not lines:
        raise ValueError("should have a line of names")
    widths = [_unquoted(line).count(_delimiter(line)) for _, line in lines[:TITLE_LINES]]
    return next(line for line, width in zip(lines, widths, strict=False) if 2 * width >= max(widths))


def _delimiter(line: str) -> str:
    return max(DELIMITERS, key=_unquoted(line).count)


def _unquoted(line: str) -> str:
    return re.sub('"[^"]*"', "", line)


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
