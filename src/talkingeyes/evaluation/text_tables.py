"""Tables as text: Markdown for pages, CSV for programs, aligned columns for terminals."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Column:
    """A column: heading, metric (its name, or part/name) and number of decimals."""

    heading: str
    metric: str
    digits: int = 3


def training_budget(model: Mapping[str, Any]) -> str:
    """The training of a model, by its settings, in words; empty for one without training steps."""
    loop = model.get("loop")
    return f"{loop['steps']:,} × {loop['batch']} windows at {loop['learning_rate']:g}" if loop else ""


def training_sentence(budgets: Mapping[str, str]) -> str:
    """The training of most rows, and that of the others by title; empty without any."""
    known = {title: budget for title, budget in budgets.items() if budget}
    if not known:
        return ""
    usual = max(set(known.values()), key=list(known.values()).count)
    others = "".join(f"; {title}: {budget}" for title, budget in known.items() if budget != usual)
    return f"Trained with {usual}{others}."


def markdown_row(cells: Sequence[str]) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join(map(markdown_row, [headings, ["---"] * len(headings), *rows]))


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as text for a terminal, in columns of equal width."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
