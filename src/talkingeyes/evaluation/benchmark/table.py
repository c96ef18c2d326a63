"""The benchmark as JSON, CSV and text; JSON reads back to the same rows."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from talkingeyes.evaluation.benchmark.registry import MEASURES
from talkingeyes.evaluation.benchmark.tally import Row
from talkingeyes.evaluation.bootstrap import Estimate

SCHEMA = "talkingeyes.benchmark/1"
ESTIMATES = ("value", "reference", "difference")
LIMITS = ("value", "low", "high")
BY_NAME = {measure.name: measure for measure in MEASURES}


def as_json(rows: Sequence[Row], facts: Mapping[str, Any]) -> str:
    """All rows, with what they are of."""
    measures = {
        row.measure.name: {
            "count": row.count,
            "counted": row.measure.counted,
            **{name: asdict(found) if (found := getattr(row, name)) else None for name in ESTIMATES},
            "apart": row.apart,
            "reason": row.reason,
            "unit": row.measure.unit,
            "direction": row.measure.direction,
        }
        for row in rows
    }
    return json.dumps({"schema": SCHEMA, **facts, "measures": measures}, indent=1)


def from_json(content: Mapping[str, Any]) -> list[Row]:
    """The rows of measures that there still are."""
    return [
        Row(
            BY_NAME[name],
            entry["count"],
            **{key: Estimate(**entry[key]) if entry[key] else None for key in ESTIMATES},
            reason=entry["reason"],
        )
        for name, entry in content["measures"].items()
        if name in BY_NAME
    ]


def comma_separated(rows: Sequence[Row]) -> str:
    """A line a measure."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    limits = [f"{name}{'' if limit == 'value' else '_' + limit}" for name in ESTIMATES for limit in LIMITS]
    writer.writerow(["measure", "unit", "direction", "count", "counted", *limits, "apart", "reason"])
    for row in rows:
        cells = [
            f"{getattr(found, limit):.6g}" if (found := getattr(row, name)) else ""
            for name in ESTIMATES
            for limit in LIMITS
        ]
        measure = row.measure
        apart = "" if row.apart is None else str(row.apart).lower()
        writer.writerow(
            [measure.name, measure.unit, measure.direction, row.count, measure.counted, *cells, apart, row.reason]
        )
    return text.getvalue()


def as_text(rows: Sequence[Row]) -> str:
    """For a terminal: value and reference with intervals; `!` marks what is apart from the reference."""
    cells = [
        (
            "!" if row.apart else "",
            row.measure.name,
            written(row.value),
            written(row.reference),
            row.measure.unit,
            row.reason,
        )
        for row in rows
    ]
    cells = [("", "measure", "value", "reference", "unit", ""), *cells]
    widths = [max(len(line[column]) for line in cells) for column in range(5)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, [*widths, 0], strict=True)).rstrip() for line in cells
    )


def markdown(tables: Mapping[str, Sequence[Row]], titles: Mapping[str, str]) -> str:
    """A line a measure, a column a set of motions; bold: apart from the reference."""
    names = list(tables)
    by_measure = {name: {row.measure.name: row for row in rows} for name, rows in tables.items()}
    lines = ["| measure | unit | " + " | ".join(titles.get(name, name) for name in names) + " |"]
    lines.append("| --- " * (len(names) + 2) + "|")
    for measure in MEASURES:
        rows = [by_measure[name].get(measure.name) for name in names]
        if any(row and row.value for row in rows):
            lines.append(f"| {measure.title} | {measure.unit} | " + " | ".join(_cell(row) for row in rows) + " |")
    return "\n".join(lines)


def written(estimate: Estimate | None) -> str:
    """Three significant digits of a figure, with its interval."""
    if estimate is None:
        return ""
    return f"{estimate.value:.3g} [{estimate.low:.3g}, {estimate.high:.3g}]"


def _cell(row: Row | None) -> str:
    if row is None or row.value is None:
        return ""
    value = f"{row.value.value:.3g}"
    value = f"**{value}**" if row.apart else value
    return f"{value} <sub>{row.value.low:.3g}–{row.value.high:.3g}</sub>"
