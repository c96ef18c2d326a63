"""The page of the paper's tables and its JSON: claims, tables beside the paper's values, and the order of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from talkingeyes.evaluation.papers.talkingeyes_claims import (
    CLAIMS,
    LEVEL,
    NOT_REPRODUCED,
    REPRODUCED,
    Claim,
    RankOrder,
    Verdict,
    judge,
    rank_order,
)
from talkingeyes.evaluation.papers.talkingeyes_results import SeedMean, SeedResult, SplitResult, mean_over_seeds
from talkingeyes.evaluation.papers.talkingeyes_tables import FAMILIES, HEAD_AND_EYE_COLUMNS, TABLES, TITLES, PaperTable
from talkingeyes.evaluation.text_tables import Column, markdown_table, training_sentence

# Metrics that are shown besides the columns of the paper.
SHOWN = {
    "gaze/speed",
    "gaze/still_fraction",
    "head/range_ratio",
    "gaze/range_ratio",
    "head/speed_above_5hz",
    "gaze/speed_above_5hz",
}
SHOWN_SPLIT = "unseen"
CLAIMS_TEXT = """## The paper's claims

A claim is reproduced if the interval of the difference, a mean over seeds (95 %, over speakers and seeds), lies on its
side of 0, not reproduced if it lies on the other, else undecided (`evaluation/papers/talkingeyes_claims.py`). Where the
eyes of a row stand still though the paper's move, the columns of the eyes decide nothing
([why](../log/2026-11-22-why-the-papers-order-differs.md)). A claim is decided by the rows of its table (Table II: those
of Table V) in the column that it names. {verdicts} verdicts were asked for and {decided} fell; if no row differed from
another, {chance:.1f} would fall by chance. The {firm} marked * hold with intervals that make one such verdict among all
of them unlikely (5 %, Bonferroni).
"""
ORDERS_TEXT = """## The paper's order of rows

Kendall's tau over all pairs of rows with different values in the paper: agreeing minus reversed pairs, divided by all
pairs. +1 is the paper's order. Pairs with their differences and significance: `orders` in
[tables.json](tables.json).
"""

# {table: its results, one for each seed}.
Results = Mapping[str, Sequence[SeedResult]]


def page(results: Results) -> str:
    """The page below its introduction, of the results that are there."""
    return "\n".join(
        [_claims(results), *(_table(TABLES[name], seeds) for name, seeds in results.items()), _orders(results)]
    )


def as_json(results: Results) -> dict[str, Any]:
    """All numbers: {tables: {table: {seeds, rows, orders}}, claims}.

    A row has the paper's numbers (`paper`), its training (`budget`) and by split its metrics; a metric has its mean
    over seeds, their range, and its `intervals` over sounds and over speakers.
    """
    return {
        "tables": {name: _table_json(TABLES[name], seeds) for name, seeds in results.items()},
        "claims": [_claim_json(claim, results[claim.table]) for claim in CLAIMS if claim.table in results],
    }


def by_split(seeds: Sequence[SeedResult]) -> dict[str, list[SplitResult]]:
    """The results of every split that all seeds have."""
    return {
        name: [each.splits[name] for each in seeds] for name in seeds[0].splits if all(name in s.splits for s in seeds)
    }


def cell(seeds: Sequence[SplitResult], row: str, metric: str) -> SeedMean | None:
    """A cell over the seeds that have it; None if none has."""
    found = [each.rows[row][metric] for each in seeds if metric in each.rows.get(row, {})]
    return mean_over_seeds(found) if found else None


def _claims(results: Results) -> str:
    seeds = {name: by_split(found).get(SHOWN_SPLIT) for name, found in results.items()}
    judged = [
        (claim, family, judge(claim, family, found), found)
        for claim in CLAIMS
        if (found := seeds.get(claim.table))
        for family in FAMILIES
    ]
    verdicts = sum(bool(verdict.verdict) for _, _, verdict, _ in judged)
    cells, decided, firm = dict[Claim, list[str]](), 0, 0
    for claim, family, verdict, found in judged:
        is_decided = verdict.verdict in (REPRODUCED, NOT_REPRODUCED)
        level = 1 - (1 - LEVEL) / max(verdicts, 1)
        is_firm = is_decided and judge(claim, family, found, level).verdict == verdict.verdict
        decided, firm = decided + is_decided, firm + is_firm
        cells.setdefault(claim, []).append(_verdict(verdict, is_firm))
    lines = [[f"{claim.text} ({claim.source})", *each] for claim, each in cells.items()]
    text = CLAIMS_TEXT.format(verdicts=verdicts, decided=decided, firm=firm, chance=(1 - LEVEL) * verdicts)
    return "\n".join([text, markdown_table(["claim", *FAMILIES.values()], lines), ""])


def _verdict(verdict: Verdict, is_firm: bool) -> str:
    if not verdict.verdict:
        return verdict.reason
    return f"**{verdict.verdict}**{'*' if is_firm else ''}: {verdict.reason}"


def _table(table: PaperTable, seeds: Sequence[SeedResult]) -> str:
    columns = [*table.paper_columns, *(each for each in table.extra_columns if each.metric in SHOWN)]
    splits, budgets = by_split(seeds), seeds[0].budgets
    lines = []
    for row in _rows(splits.get(SHOWN_SPLIT, ())):
        papers = table.rows.get(row) or ()
        cells = [
            _cell(cell(splits[SHOWN_SPLIT], row, each.metric), papers[at : at + 1], each)
            for at, each in enumerate(columns)
        ]
        lines.append([TITLES[row], *cells])
    headings = ["", *(each.heading for each in columns)]
    of = ", ".join(str(each.seed) for each in seeds)
    training = training_sentence({TITLES[row]: budget for row, budget in budgets.items()})
    text = f"{table.question} Means over the seeds {of}. {training}"
    return "\n".join([f"## {table.title}", "", text, "", markdown_table(headings, lines), ""])


def _rows(seeds: Sequence[SplitResult]) -> list[str]:
    return list(dict.fromkeys(row for each in seeds for row in each.rows))


def _cell(estimate: SeedMean | None, paper: Sequence[float], column: Column) -> str:
    papers = "".join(f" ({each:.3f})" for each in paper)
    return "" if estimate is None else f"{estimate.value:.{column.digits}f}{papers}"


def _orders(results: Results) -> str:
    """Kendall's tau by table, family and column."""
    lines = []
    for name, seeds in results.items():
        title = TABLES[name].title.partition(":")[0].partition(",")[0]
        if of_split := by_split(seeds).get(SHOWN_SPLIT):
            for family, words in FAMILIES.items():
                orders = _rank_orders(TABLES[name], family, of_split)
                taus = [orders.get(each.metric) for each in HEAD_AND_EYE_COLUMNS]
                lines.append([f"{title}, {words}", *(f"{each.tau:+.2f}" if each else "" for each in taus)])
    return "\n".join([ORDERS_TEXT, markdown_table(["", *(each.heading for each in HEAD_AND_EYE_COLUMNS)], lines), ""])


def _rank_orders(table: PaperTable, family: str, seeds: Sequence[SplitResult]) -> dict[str, RankOrder]:
    orders = {each.metric: rank_order(table, family, each.metric, seeds) for each in table.paper_columns}
    return {metric: each for metric, each in orders.items() if each is not None}


def _table_json(table: PaperTable, seeds: Sequence[SeedResult]) -> dict[str, Any]:
    splits, metrics = by_split(seeds), [each.metric for each in table.paper_columns]
    rows: dict[str, Any] = {}
    for split, of_split in splits.items():
        for name in _rows(of_split):
            numbers = table.rows.get(name)
            paper = dict(zip(metrics, numbers, strict=True)) if numbers else None
            row = rows.setdefault(name, {"paper": paper, "budget": seeds[0].budgets.get(name)})
            found = {each.metric: cell(of_split, name, each.metric) for each in table.columns}
            row[split] = {metric: _mean_json(each) for metric, each in found.items() if each}
    orders = {
        split: {
            family: {metric: _order_json(each) for metric, each in _rank_orders(table, family, of_split).items()}
            for family in FAMILIES
        }
        for split, of_split in splits.items()
    }
    return {"seeds": [each.seed for each in seeds], "rows": rows, "orders": orders}


def _mean_json(mean: SeedMean) -> dict[str, Any]:
    return {
        "value": mean.value,
        "seed_min": mean.seed_min,
        "seed_max": mean.seed_max,
        "intervals": [
            {"interval_over": "sounds", "low": mean.low, "high": mean.high},
            {"interval_over": "speakers", "low": mean.speakers_low, "high": mean.speakers_high},
        ],
    }


def _order_json(order: RankOrder) -> dict[str, Any]:
    pairs = [
        {
            "higher": pair.higher,
            "lower": pair.lower,
            "difference": _mean_json(pair.difference),
            "agrees": pair.agrees,
            "significant": pair.is_significant,
        }
        for pair in order.pairs
    ]
    return {"tau": order.tau, "agreeing": order.agreement_count, "pairs": pairs}


def _claim_json(claim: Claim, seeds: Sequence[SeedResult]) -> dict[str, Any]:
    verdicts = {
        split: {family: asdict(judge(claim, family, of_split)) for family in FAMILIES}
        for split, of_split in by_split(seeds).items()
    }
    return {"claim": claim.text, "source": claim.source, "table": claim.table, "verdicts": verdicts}
