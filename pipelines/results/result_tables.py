"""Tables of a result page: read from its complete Markdown, a few columns for the page, all of them as CSV.

Used by: pipelines.results.posegan_table, pipelines.results.reference_ranges.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from talkingeyes.evaluation.text_tables import csv_text, markdown_table

BORDER = re.compile(r"(?<!\\)\|")
SMALL_PRINT = re.compile(r" ?<sub>(.*?)</sub>")


@dataclass(frozen=True)
class ResultTable:
    """A table and the heading above it; `rows` without the headings of the columns."""

    section: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self, columns: Sequence[str], keep: Callable[[Sequence[str]], bool] = lambda row: True) -> str:
        """Some columns of the rows to keep, without the small print of their cells."""
        places = [self.columns.index(name) for name in columns]
        rows = [[SMALL_PRINT.sub("", row[at]) for at in places] for row in self.rows if keep(row)]
        return markdown_table([SMALL_PRINT.sub("", name) for name in columns], rows)


def read_tables(markdown: str) -> dict[str, ResultTable]:
    """All tables of a page by section; there may be one in each section."""
    sections: dict[str, list[tuple[str, ...]]] = {}
    section = ""
    for line in markdown.splitlines():
        if line.startswith("#"):
            section = line.lstrip("# ")
        elif line.startswith("|"):
            sections.setdefault(section, []).append(tuple(cell.strip() for cell in BORDER.split(line)[1:-1]))
    return {name: ResultTable(name, rows[0], tuple(rows[2:])) for name, rows in sections.items()}


def as_csv(tables: Iterable[ResultTable]) -> str:
    """All tables as CSV, one under the other, the section in the first column; small print is in brackets."""
    return csv_text(
        [table.section or "section", *map(_plain, row)] for table in tables for row in (table.columns, *table.rows)
    )


def _plain(cell: str) -> str:
    return SMALL_PRINT.sub(r" [\1]", cell).replace("**", "").replace("`", "").replace("\\|", "|")
