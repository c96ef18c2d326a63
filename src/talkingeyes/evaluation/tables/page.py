"""The tables as Markdown and JSON: the paper's value and ours with interval and seed range, then the order of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.multi_seed import MultiSeedEstimate, MultiSeedStatistic
from talkingeyes.evaluation.paper_metrics.table3 import SPLIT_TITLES, markdown_row
from talkingeyes.evaluation.tables.definitions import REFERENCES, TITLES, Column, PaperTable
from talkingeyes.evaluation.tables.rank_order import RankOrder, RowPair, rank_order


@dataclass(frozen=True)
class TableResult:
    """Results of one table in one split: estimates by row and metric, rank orders by metric."""

    cells: dict[str, dict[str, MultiSeedEstimate]]
    rank_orders: dict[str, RankOrder]


def table_result(
    table: PaperTable, rows: Mapping[str, Mapping[str, MultiSeedStatistic]], settings: BootstrapSettings
) -> TableResult:
    """Compute the estimates and rank orders of a table in one split."""
    shown = [name for name in (*REFERENCES, *table.rows) if rows.get(name)]
    columns = (*table.paper_columns, *table.extra_columns)
    cells = {
        name: {each.metric: rows[name][each.metric].estimate(settings) for each in columns if each.metric in rows[name]}
        for name in shown
    }
    rank_orders = {}
    for at, column in enumerate(table.paper_columns):
        paper = {name: numbers[at] for name, numbers in table.rows.items() if numbers is not None}
        ours = {name: rows[name][column.metric] for name in paper if column.metric in rows.get(name, {})}
        result = rank_order(paper, ours, settings)
        if result is not None:
            rank_orders[column.metric] = result
    return TableResult(cells, rank_orders)


def markdown(table: PaperTable, by_split: Mapping[str, TableResult]) -> str:
    """Markdown of one table, for each split."""
    lines = [f"## {table.title}", "", table.question, ""]
    for split, result in by_split.items():
        lines += [f"### {SPLIT_TITLES[split]}", "", *_cells(table, result), ""]
        if result.rank_orders:
            lines += ["Comparison with the paper's order, by pairs of rows:", "", *_orders(table, result), ""]
    return "\n".join(lines)


def as_json(table: PaperTable, by_split: Mapping[str, TableResult]) -> dict[str, Any]:
    """Results as numbers: {rows: {row: {paper, split: {metric: estimate}}}, orders: {split: {metric: ...}}}."""
    figures = [each.metric for each in table.paper_columns]
    rows: dict[str, Any] = {}
    for split, result in by_split.items():
        for name, cells in result.cells.items():
            numbers = table.rows.get(name)
            row = rows.setdefault(name, {"paper": dict(zip(figures, numbers, strict=True)) if numbers else None})
            row[split] = {metric: asdict(estimate) for metric, estimate in cells.items()}
    return {
        "rows": rows,
        "orders": {
            split: {name: _plain(each) for name, each in result.rank_orders.items()}
            for split, result in by_split.items()
        },
    }


def _plain(each: RankOrder) -> dict[str, Any]:
    pairs = [asdict(pair) | {"agrees": pair.agrees, "clear": pair.is_significant} for pair in each.pairs]
    return {"same": each.all_agree, "agreeing": each.agreement_count, "pairs": pairs, "tau": each.tau}


def _cells(table: PaperTable, result: TableResult) -> list[str]:
    columns = (*table.paper_columns, *table.extra_columns)
    lines = [markdown_row(["", *(each.heading for each in columns)]), markdown_row(["---"] * (len(columns) + 1))]
    for name, cells in result.cells.items():
        numbers = table.rows.get(name) or (None,) * len(table.paper_columns)
        papers = (*numbers, *(None,) * len(table.extra_columns))
        written = [_cell(cells.get(each.metric), paper, each) for each, paper in zip(columns, papers, strict=True)]
        lines.append(markdown_row([TITLES[name], *written]))
    return lines


def _cell(estimate: MultiSeedEstimate | None, paper: float | None, column: Column) -> str:
    parts = [] if paper is None else [f"paper {paper:.{max(column.digits, 3)}f}"]
    if estimate is not None:
        digits = column.digits
        small = f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"
        if estimate.seed_min < estimate.seed_max:
            small += f"; seeds {estimate.seed_min:.{digits}f} to {estimate.seed_max:.{digits}f}"
        parts.insert(0, f"**{estimate.value:.{digits}f}**<br><sub>{small}</sub>")
    return "<br>".join(parts)


def _orders(table: PaperTable, result: TableResult) -> list[str]:
    lines = [
        markdown_row(
            ["", "same order", "agreeing pairs", "Kendall's tau", "reversed (significant)", "not significant"]
        ),
        markdown_row(["---"] * 6),
    ]
    for column in table.paper_columns:
        if column.metric not in result.rank_orders:
            continue
        each = result.rank_orders[column.metric]
        is_significant = [pair for pair in each.pairs if pair.is_significant and not pair.agrees]
        unclear = [pair for pair in each.pairs if not pair.is_significant]
        share = f"{each.agreement_count} of {len(each.pairs)}"
        all_agree = "yes" if each.all_agree else "no"
        lines.append(
            markdown_row(
                [column.heading, all_agree, share, f"{each.tau:+.2f}", _named(is_significant), _named(unclear)]
            )
        )
    return lines


def _named(pairs: Sequence[RowPair]) -> str:
    """List pairs as "higher > lower", in the order of the paper."""
    return "; ".join(f"{_short(pair.higher)} > {_short(pair.lower)}" for pair in pairs) or "–"


def _short(name: str) -> str:
    return TITLES[name].partition(" (")[0]
