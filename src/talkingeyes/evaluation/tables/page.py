"""The tables as a page: for every cell the paper's value and ours with interval and range, then the order of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.seeds import Seeded, SeededEstimate
from talkingeyes.evaluation.table import SPLIT_TITLES, line
from talkingeyes.evaluation.tables.declared import REFERENCES, TITLES, Column, PaperTable
from talkingeyes.evaluation.tables.order import Order, Pair, order


@dataclass(frozen=True)
class Found:
    """What came out of one table in one split: estimates by row and figure, the order by figure."""

    cells: dict[str, dict[str, SeededEstimate]]
    orders: dict[str, Order]


def found(table: PaperTable, rows: Mapping[str, Mapping[str, Seeded]], settings: BootstrapSettings) -> Found:
    """The table of these rows in one split."""
    shown = [name for name in (*REFERENCES, *table.rows) if rows.get(name)]
    columns = (*table.compared, *table.beside)
    cells = {
        name: {each.figure: rows[name][each.figure].estimate(settings) for each in columns if each.figure in rows[name]}
        for name in shown
    }
    orders = {}
    for at, column in enumerate(table.compared):
        paper = {name: numbers[at] for name, numbers in table.rows.items() if numbers is not None}
        ours = {name: rows[name][column.figure] for name in paper if column.figure in rows.get(name, {})}
        came = order(paper, ours, settings)
        if came is not None:
            orders[column.figure] = came
    return Found(cells, orders)


def markdown(table: PaperTable, by_split: Mapping[str, Found]) -> str:
    """One table, for each split."""
    lines = [f"## {table.title}", "", table.question, ""]
    for split, came in by_split.items():
        lines += [f"### {SPLIT_TITLES[split]}", "", *_cells(table, came), ""]
        if came.orders:
            lines += ["The paper's order, pair by pair:", "", *_orders(table, came), ""]
    return "\n".join(lines)


def as_json(table: PaperTable, by_split: Mapping[str, Found]) -> dict[str, Any]:
    """The same as numbers: {rows: {row: {paper, split: {figure: estimate}}}, orders: {split: {figure: ...}}}."""
    figures = [each.figure for each in table.compared]
    rows: dict[str, Any] = {}
    for split, came in by_split.items():
        for name, cells in came.cells.items():
            numbers = table.rows.get(name)
            row = rows.setdefault(name, {"paper": dict(zip(figures, numbers, strict=True)) if numbers else None})
            row[split] = {figure: asdict(estimate) for figure, estimate in cells.items()}
    return {
        "rows": rows,
        "orders": {
            split: {name: _plain(each) for name, each in came.orders.items()} for split, came in by_split.items()
        },
    }


def _plain(each: Order) -> dict[str, Any]:
    pairs = [asdict(pair) | {"agrees": pair.agrees, "clear": pair.clear} for pair in each.pairs]
    return {"same": each.same, "agreeing": each.agreeing, "pairs": pairs, "tau": each.tau}


def _cells(table: PaperTable, came: Found) -> list[str]:
    columns = (*table.compared, *table.beside)
    lines = [line(["", *(each.heading for each in columns)]), line(["---"] * (len(columns) + 1))]
    for name, cells in came.cells.items():
        numbers = table.rows.get(name) or (None,) * len(table.compared)
        papers = (*numbers, *(None,) * len(table.beside))
        written = [_cell(cells.get(each.figure), paper, each) for each, paper in zip(columns, papers, strict=True)]
        lines.append(line([TITLES[name], *written]))
    return lines


def _cell(estimate: SeededEstimate | None, paper: float | None, column: Column) -> str:
    parts = [] if paper is None else [f"paper {paper:.{max(column.digits, 3)}f}"]
    if estimate is not None:
        digits = column.digits
        small = f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"
        if estimate.least < estimate.most:
            small += f"; seeds {estimate.least:.{digits}f} to {estimate.most:.{digits}f}"
        parts.insert(0, f"**{estimate.value:.{digits}f}**<br><sub>{small}</sub>")
    return "<br>".join(parts)


def _orders(table: PaperTable, came: Found) -> list[str]:
    lines = [
        line(["", "same order", "pairs that agree", "Kendall's tau", "reversed, clearly", "not told apart by clips"]),
        line(["---"] * 6),
    ]
    for column in table.compared:
        if column.figure not in came.orders:
            continue
        each = came.orders[column.figure]
        clear = [pair for pair in each.pairs if pair.clear and not pair.agrees]
        unclear = [pair for pair in each.pairs if not pair.clear]
        share = f"{each.agreeing} of {len(each.pairs)}"
        same = "yes" if each.same else "no"
        lines.append(line([column.heading, same, share, f"{each.tau:+.2f}", _named(clear), _named(unclear)]))
    return lines


def _named(pairs: Sequence[Pair]) -> str:
    """Pairs, the row that the paper has above first."""
    return "; ".join(f"{_short(pair.above)} > {_short(pair.below)}" for pair in pairs) or "–"


def _short(name: str) -> str:
    return TITLES[name].partition(" (")[0]
