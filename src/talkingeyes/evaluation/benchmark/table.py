"""Benchmark results as JSON, CSV, text and Markdown; JSON is read back to the same rows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.benchmark.registry import METRICS, SCHEMA, VERSION, BenchmarkDocument
from talkingeyes.evaluation.bootstrap import Estimate
from talkingeyes.evaluation.text_tables import aligned, csv_text

ESTIMATES = ("value", "reference", "difference")
LIMITS = ("value", "low", "high")
METRICS_BY_NAME = {metric.name: metric for metric in METRICS}


def as_json(rows: Sequence[MetricResult], metadata: Mapping[str, Any], random: Sequence[MetricResult] = ()) -> str:
    """All rows as JSON, with metadata (number of sounds, frame rate), beside the baseline `random` if given."""
    baseline = {row.metric.name: {"random": row.value, "random_worse": row.worse} for row in random}
    metrics = {
        row.metric.name: {
            "count": row.count,
            "count_unit": row.metric.count_unit,
            **{name: getattr(row, name) for name in ESTIMATES},
            "worse": row.worse,
            "reason": row.reason,
            "unit": row.metric.unit,
            "direction": row.metric.direction,
            **baseline.get(row.metric.name, {}),
        }
        for row in rows
    }
    head = {"schema": SCHEMA, "benchmark_version": VERSION}
    document = BenchmarkDocument.model_validate({**head, **metadata, "metrics": metrics})
    return json.dumps(document.model_dump(by_alias=True, exclude_unset=True), indent=1)


def from_json(content: Mapping[str, Any]) -> list[MetricResult]:
    """Rows of the metrics that still exist; others are ignored."""
    return [
        MetricResult(
            METRICS_BY_NAME[name],
            entry["count"],
            **{key: Estimate(**entry[key]) if entry[key] else None for key in ESTIMATES},
            reason=entry["reason"],
        )
        for name, entry in content["metrics"].items()
        if name in METRICS_BY_NAME
    ]


def to_csv(rows: Sequence[MetricResult], random: Sequence[MetricResult] = ()) -> str:
    """CSV with one line for each metric, with the values of the baseline `random` if given."""
    baseline = {row.metric.name: row for row in random}
    limits = [f"{name}{'' if limit == 'value' else '_' + limit}" for name in ESTIMATES for limit in LIMITS]
    more = ("random", "random_worse") if random else ()
    lines = [["metric", "unit", "direction", "count", "count_unit", *limits, "worse", "reason", *more]]
    for row in rows:
        cells = [
            f"{getattr(found, limit):.6g}" if (found := getattr(row, name)) else ""
            for name in ESTIMATES
            for limit in LIMITS
        ]
        metric = row.metric
        description = (metric.name, metric.unit, metric.direction, row.count, metric.count_unit)
        other = baseline.get(metric.name)
        beside = (f"{other.value.value:.6g}" if other and other.value else "", _flag(other)) if random else ()
        lines.append([*description, *cells, _flag(row), row.reason, *beside])
    return csv_text(lines)


def _flag(row: MetricResult | None) -> str:
    return "" if row is None or row.worse is None else str(row.worse).lower()


def as_text(rows: Sequence[MetricResult], random: Sequence[MetricResult] = ()) -> str:
    """Table for a terminal: value and reference with intervals, and the value of the baseline `random` if given; `!`
    marks values worse than the reference."""
    baseline = {row.metric.name: row for row in random}
    cells = [("", "metric", "value", "reference", *(["random"] if random else []), "unit", "")]
    for row in rows:
        other = baseline.get(row.metric.name)
        beside = ("! " if other.worse else "") + f"{other.value.value:.3g}" if other and other.value else ""
        marked = ("!" if row.worse else "", row.metric.name, format_estimate(row.value), format_estimate(row.reference))
        cells.append((*marked, *([beside] if random else []), row.metric.unit, row.reason))
    return aligned(cells)


def markdown(tables: Mapping[str, Sequence[MetricResult]], titles: Mapping[str, str]) -> str:
    """Markdown table: a line for each metric, a column for each set of motions; bold: worse than the reference."""
    names = list(tables)
    by_measure = {name: {row.metric.name: row for row in rows} for name, rows in tables.items()}
    lines = ["| metric | unit | " + " | ".join(titles.get(name, name) for name in names) + " |"]
    lines.append("| --- " * (len(names) + 2) + "|")
    for metric in METRICS:
        rows = [by_measure[name].get(metric.name) for name in names]
        if any(row and row.value for row in rows):
            lines.append(f"| {metric.title} | {metric.unit} | " + " | ".join(_cell(row) for row in rows) + " |")
    return "\n".join(lines)


def format_estimate(estimate: Estimate | None) -> str:
    """Value with its interval, three significant digits."""
    if estimate is None:
        return ""
    return f"{estimate.value:.3g} [{estimate.low:.3g}, {estimate.high:.3g}]"


def _cell(row: MetricResult | None) -> str:
    if row is None or row.value is None:
        return ""
    value = f"{row.value.value:.3g}"
    value = f"**{value}**" if row.worse else value
    return f"{value} <sub>{row.value.low:.3g}–{row.value.high:.3g}</sub>"
