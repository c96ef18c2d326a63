"""Table III as Markdown and CSV.

The rows are those of the paper's Table III plus truth, fitted and mismatched motion, next to the paper's own numbers on
TKED-Test. Those come from another corpus and another critic: compare the order of rows, not the values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from talkingeyes.evaluation.text_tables import Column, csv_text, markdown_table

# {split: {part: {metric: {value, low, high, ...}}}}, as the stage `evaluate` writes it for each row.
MethodMetrics = Mapping[str, Any]

TITLES = {
    "truth": "Truth",
    "fitted": "Fitted motion",
    "mismatched": "Mismatched motion",
    "mean": "Mean",
    "random": "Random",
    "similar": "Similar Sample",
    "aligned_replay": "Lookup, aligned in loudness",
    "pieced_replay": "Lookup, a piece an onset",
    "untrained": "Untrained (events, random weights)",
    "vae": "VAE",
    "talkingeyes_paper": "TalkingEyes, the paper's equations",
    "talkingeyes": "TalkingEyes",
    "talkingeyes_events": "TalkingEyes, events (default of animate)",
    "talkingeyes_live": "TalkingEyes, live (lookahead 0.24 s)",
}
# Tables III and V of the paper: Diversity, Corr., L2.
PUBLISHED = {
    "gaze": {
        "mean": (0.0, 0.45685, 0.17162),
        "random": (0.23383, 0.49117, 0.23989),
        "similar": (0.06170, 0.57849, 0.23479),
        "vae": (0.06655, 0.45796, 0.17887),
        "talkingeyes_paper": (0.26398, 0.60435, 0.26570),
    },
    "head": {"vae": (0.09645, 0.52148, 0.23699), "talkingeyes_paper": (0.05143, 0.51913, 0.22731)},
}

INTERVALS = ("low", "high", "speakers_low", "speakers_high")  # over clips, over speakers

COLUMNS = {
    "gaze": (
        Column("Div.", "gaze/diversity"),
        Column("Div. ratio to truth", "gaze/diversity_ratio", 2),
        Column("Corr. eye-in-head", "gaze/corr"),
        Column("Corr. gaze in space", "gaze_in_space/corr"),
        Column("L2", "gaze/l2"),
        Column("speed °/s", "gaze/speed", 1),
        Column("99th percentile speed °/s", "gaze/speed_p99", 0),
        Column("still frames, eyes", "gaze/still_fraction", 2),
        Column("still frames, gaze in space", "gaze_in_space/still_fraction", 2),
    ),
    "head": (
        Column("Div.", "head/diversity"),
        Column("Div. ratio to truth", "head/diversity_ratio", 2),
        Column("Corr.", "head/corr"),
        Column("L2", "head/l2"),
        Column("speed °/s", "head/speed", 1),
        Column("99th percentile speed °/s", "head/speed_p99", 0),
    ),
}
CSV_COLUMNS = tuple(dict.fromkeys((*COLUMNS["gaze"], *COLUMNS["head"])))
SPLIT_TITLES = {"test": "Test: training speakers, new sentences", "unseen": "Unseen: new speakers"}


def order_rows(rows: Mapping[str, MethodMetrics]) -> list[str]:
    """Row names in the order of the table; unknown rows come last."""
    return [*(name for name in TITLES if name in rows), *sorted(set(rows) - set(TITLES))]


def metric(table: MethodMetrics, split: str, part: str, name: str) -> Mapping[str, float] | None:
    """A metric with its interval, or None if the row lacks it."""
    found: Mapping[str, float] | None = table.get(split, {}).get(part, {}).get(name)
    return found


def metric_of(column: Column, table: MethodMetrics, split: str) -> Mapping[str, float] | None:
    """The metric of a column whose metric is part/name."""
    return metric(table, split, *column.metric.split("/"))


def markdown(rows: Mapping[str, MethodMetrics]) -> str:
    """Markdown tables of eyes (Table III) and head for each split."""
    lines: list[str] = []
    for split, title in SPLIT_TITLES.items():
        for part, columns in COLUMNS.items():
            lines += [f"### {title}: {'eyes' if part == 'gaze' else 'head'}", ""]
            headings = ["", *(column.heading for column in columns), "paper: Div., Corr., L2"]
            cells = [_cells(name, rows[name], split, part) for name in order_rows(rows)]
            lines += [markdown_table(headings, cells), ""]
    return "\n".join(lines)


def to_csv(rows: Mapping[str, MethodMetrics]) -> str:
    """CSV of the same tables, one line for each split and row, with the limits of every interval."""
    headings = [column.metric.replace("/", "_") for column in CSV_COLUMNS]
    limits = [f"{heading}{limit}" for heading in headings for limit in ("", *(f"_{each}" for each in INTERVALS))]
    papers = [f"paper_{part}_{name}" for part in PUBLISHED for name in ("diversity", "corr", "l2")]
    lines = [["split", "row", *limits, *papers]]
    for split in SPLIT_TITLES:
        for name in order_rows(rows):
            cells: list[str] = []
            for column in CSV_COLUMNS:
                found = metric_of(column, rows[name], split)
                cells += [f"{found[key]:.6g}" if found else "" for key in ("value", *INTERVALS)]
            for of_part in PUBLISHED.values():
                cells += [str(value) for value in of_part.get(name, ("", "", ""))]
            lines.append([split, name, *cells])
    return csv_text(lines)


def _cells(name: str, table: MethodMetrics, split: str, part: str) -> list[str]:
    found = [(column, metric_of(column, table, split)) for column in COLUMNS[part]]
    paper = PUBLISHED[part].get(name)
    return [
        TITLES.get(name, name),
        *(_written(value, column.digits, "speakers_low", "speakers_high") if value else "" for column, value in found),
        ", ".join(f"{value:.3f}" for value in paper) if paper else "",
    ]


def _written(value: Mapping[str, float], digits: int, low: str = "low", high: str = "high") -> str:
    return f"{value['value']:.{digits}f} <sub>{value[low]:.{digits}f}–{value[high]:.{digits}f}</sub>"


def critic_table(report: Mapping[str, Any]) -> str:
    """Markdown table of the scores of the critics, from critic/report.json."""
    names = ("auc_same_speaker", "auc_all", "corr_truth", "corr_shuffled", "corr_constant")
    headings = ["critic", "split", "AUC, same speaker", "AUC, all", "Corr. of truth", "shuffled", "constant"]
    rows = []
    for part, groups in report.items():
        for group, verdict in groups.items():
            cells = [_written(verdict[name], 3) if verdict[name] else "" for name in names]
            rows.append([part, group.replace("_", " "), *cells])
    return markdown_table(headings, rows)
