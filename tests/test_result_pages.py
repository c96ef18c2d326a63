"""Committed result pages are what their writers give for the committed numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pipelines import combinations, face_table, field_baselines, people, posegan_table, reference_ranges_model, tables
from talkingeyes.evaluation.bootstrap import Estimate
from talkingeyes.evaluation.face.table import face_markdown
from talkingeyes.evaluation.multi_seed import MultiSeedEstimate
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
from talkingeyes.evaluation.reference_ranges.page import label, range_text
from talkingeyes.evaluation.reference_ranges.ranges import REFERENCE_RANGES
from talkingeyes.evaluation.sensitivity.corruptions import CORRUPTIONS
from talkingeyes.evaluation.tables.definitions import TABLES
from talkingeyes.evaluation.tables.page import TableResult, as_json, markdown
from talkingeyes.evaluation.tables.rank_order import RankOrder, RowPair

DOCS = Path(__file__).parents[1] / "docs"
SEEDS = "0, 1, 2"


def numbers(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text())


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text()


def revision_of(text: str) -> str:
    return text.partition("at revision ")[2].partition(";")[0]


def test_page_of_faces() -> None:
    text = page("face_table")
    introduction = face_table.INTRODUCTION.format(revision=revision_of(text), seeds=SEEDS)
    assert text == introduction + face_markdown(numbers("face_table")) + face_table.PICTURES


def test_page_of_people() -> None:
    assert page("people") == people.page(numbers("people"))


def test_page_of_the_field_s_baselines() -> None:
    assert page("field_baselines") == field_baselines.page(numbers("field_baselines"))


def test_page_of_combinations(monkeypatch: Any) -> None:
    text, found = page("combinations"), numbers("combinations")
    monkeypatch.setattr(combinations, "revision", lambda: revision_of(text))
    loop = {"loop": {"steps": 200, "batch": 8}}
    params = {"model": dict.fromkeys(found["rows"], loop), "validate": {"bootstrap": {"confidence_level": 0.95}}}
    assert text == combinations.page(found["rows"], params, " seeds=0,1,2", found["seeds"])


def test_page_of_the_papers_tables() -> None:
    text, found = page("tables"), numbers("tables")["tables"]
    results = {name: _results(table) for name, table in found.items()}
    assert {name: as_json(TABLES[name], each) for name, each in results.items()} == found
    introduction = tables.INTRODUCTION.format(
        words="",
        revision=revision_of(text),
        seeds=SEEDS,
        level=0.95,
        count=tables.LONG_MOTIONS,
        long_s=tables.LONG_S,
    )
    assert text == introduction + "\n".join(markdown(TABLES[name], each) for name, each in results.items())


def _results(table: dict[str, Any]) -> dict[str, TableResult]:
    """Results of each split, from JSON."""
    results = {}
    for split, orders in table["orders"].items():
        cells = {
            name: {metric: MultiSeedEstimate(**each) for metric, each in row[split].items()}
            for name, row in table["rows"].items()
        }
        rank_orders = {
            metric: RankOrder(
                tuple(RowPair(each["higher"], each["lower"], Estimate(**each["difference"])) for each in order["pairs"])
            )
            for metric, order in orders.items()
        }
        results[split] = TableResult(cells, rank_orders)
    return results


def test_introductions_of_pages_without_committed_numbers() -> None:
    assert page("posegan_table").startswith(posegan_table.INTRODUCTION.format(seeds=SEEDS) + "### Table 1")
    known = {markdown_row([label(each).replace("|", "\\|"), range_text(each)])[:-1] for each in REFERENCE_RANGES}
    text = page("reference_ranges_model")
    introduction = reference_ranges_model.INTRODUCTION.partition("{words}")[0]
    assert text.startswith(introduction)
    rows = [line for line in text.splitlines() if line.startswith("| ")][2:]
    assert len(rows) > 40
    assert [row for row in rows if not any(row.startswith(each) for each in known)] == []
    listed = "\n".join(f"- *{each.name}*: {each.title}" for each in CORRUPTIONS)
    assert listed in page("sensitivity")
