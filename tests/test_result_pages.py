"""Committed result pages are what their writers give for the committed numbers."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.results import face_table, field_baselines, people, posegan_table, reference_ranges, tables
from pipelines.results.face_rows import read_rows
from pipelines.results.reference_ranges_page import PLOT_CAPTIONS, RECORDING_TITLES, label
from pipelines.results.result_tables import ResultTable, as_csv, read_tables
from pipelines.results.tables_page import as_json
from talkingeyes.animation.model_file import PACKAGED_MODELS
from talkingeyes.evaluation.benchmark.corruptions import CORRUPTIONS
from talkingeyes.evaluation.reference_ranges.ranges import REFERENCE_RANGES

DOCS = Path(__file__).parents[1] / "docs/results"


def numbers(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text())


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text()


def data_tables(name: str) -> dict[str, ResultTable]:
    """The tables of a CSV file beside a page, by section."""
    found: dict[str, list[tuple[str, ...]]] = {}
    with (DOCS / f"{name}.csv").open(newline="") as file:
        for section, *cells in csv.reader(file):
            found.setdefault(section, []).append(tuple(cells))
    return {name: ResultTable(name, rows[0], tuple(rows[1:])) for name, rows in found.items()}


def test_page_of_faces() -> None:
    rows = read_rows(DOCS / "face_rows")
    found = numbers("face_table")
    assert set(found) == set(rows)
    for name, seeds in rows.items():
        means = [np.nanmean([each.diversity for each in row.sounds["unseen"]]) for row in seeds]
        assert found[name]["unseen"]["face"]["diversity"]["value"] == pytest.approx(np.mean(means)), name
    assert page("face_table") == face_table.document(found, rows) + face_table.pictures(DOCS / "pictures")


def test_page_of_face_models_has_the_figures_of_the_report() -> None:
    report = json.loads((DOCS.parents[1] / "data" / "report" / "metrics.json").read_text())["probtalk3d"]
    for split in ("test", "unseen"):
        face = report[split]["face"]
        cells = [f"{face[key]:.2f}" for key in ("emotion_accuracy", "bilabials_closed", "mve")]
        assert f"| {' | '.join([split, *cells])} |" in (DOCS.parent / "face_models.md").read_text()


def test_page_of_people() -> None:
    assert page("people") == people.page(numbers("people"), numbers("people_timing"))


def test_page_of_the_field_s_baselines() -> None:
    assert page("field_baselines") == field_baselines.page(
        json.loads((DOCS.parents[1] / field_baselines.NUMBERS).read_text())
    )


def test_page_of_the_papers_tables() -> None:
    results = tables.read_results(DOCS / tables.SEEDS_FOLDER)
    assert numbers("tables") == as_json(results)
    assert page("tables") == tables.document(results)


def test_page_of_personal_head_motion() -> None:
    found = data_tables("posegan_table")
    plain = {name: table_without_ranges(table) for name, table in found.items()}
    text = page("posegan_table")
    assert text == posegan_table.summary(plain, [0, 1, 2])
    assert found != plain  # the ranges are in the CSV file alone


def table_without_ranges(table: ResultTable) -> ResultTable:
    rows = tuple(tuple(re.sub(r" \[.*?\]$", "", cell) for cell in row) for row in table.rows)
    return ResultTable(table.section, table.columns, rows)


def test_pages_of_reference_ranges() -> None:
    found, text = data_tables("reference_ranges"), page("reference_ranges")
    what = re.search(r"^Corpus: (.+)\.$", text, re.MULTILINE)
    assert what
    links = {name: f"pictures/reference-ranges-{name}.png" for name in PLOT_CAPTIONS}
    assert text == reference_ranges.summary(found, list(RECORDING_TITLES), what[1], links)
    rows = [row for table in found.values() for row in table.rows]
    assert len(rows) > 40
    assert {row[0] for row in rows} <= {label(each) for each in REFERENCE_RANGES}


def test_page_of_sensitivity() -> None:
    text = page("sensitivity")
    with (DOCS / "sensitivity.csv").open(newline="") as file:
        heading, *rows = list(csv.reader(file))
    with (DOCS / "sensitivity_doses.csv").open(newline="") as file:
        dose_heading, *doses = list(csv.reader(file))
    assert heading == ["metric", "true", *(each.name for each in CORRUPTIONS)]
    assert dose_heading == ["metric", *(f"{each.name} ({each.unit})" for each in CORRUPTIONS if each.doses)]
    tested = {row[0] for row in rows}
    assert [row[0] for row in doses if row[0] in tested] == [row[0] for row in rows]
    assert f"metrics that detect it, of {len(rows)}" in text
    personal = set(re.findall("`(.+?)`", re.search(r"Places of one's own\*\*: (.*) detect nothing", text)[1]))
    assert personal == {row[0] for row in rows if not any(cell != "gone" and float(cell) > 1 for cell in row[2:])}
    same_pool = [row for row in doses if row[0] in tested - personal]
    for at, each in enumerate(CORRUPTIONS, 2):
        gone = sum(row[at] == "gone" for row in rows)
        line = re.search(rf"^\| {each.name} \| {re.escape(each.title)} \| \d+ \| {gone} \|.*", text, re.MULTILINE)
        assert line
        if each.doses:
            column = dose_heading.index(f"{each.name} ({each.unit})")
            least = min((row[column] for row in same_pool if row[column]), key=float)
            first = next(row[0] for row in same_pool if row[column] == least)
            bound = "≤ " if float(least) <= 1.01 * each.doses[0] else ""
            assert f"| {bound}{least} {each.unit} | `{first}`" in line[0]
    elsewhere = {row[0]: row[1:] for row in doses if row[0] not in tested - personal}
    units = [(each.name, each.unit) for each in CORRUPTIONS if each.doses]
    shown = {
        name.strip("`"): {cell.replace("≤ ", "") for cell in detected.split(", ")}
        for name, _, detected in read_tables(text)["Metrics that need other takes"].rows
    }
    assert shown == {
        name: {f"{fault} ({dose} {unit})" for (fault, unit), dose in zip(units, row, strict=True) if dose}
        for name, row in elsewhere.items()
    }
    blind = [f"`{row[0]}`" for row in doses if not any(row[1:])]
    assert f"nothing at all (marked † in [benchmark.md](../benchmark.md)): {', '.join(blind) or 'none'}." in text


def test_the_packaged_models_are_those_of_the_newest_release_report() -> None:
    newest = page("releases").rpartition("\n## ")[2]
    for path in PACKAGED_MODELS.values():
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        assert f"- `{path.name}`: sha256 `{digest}`" in newest


def test_tables_survive_markdown_and_csv() -> None:
    text = "## A\n\n| a | b\\|c |\n| --- | --- |\n| `x` | **1** <sub>0–2</sub> |\n| y | 2 |\n"
    table = read_tables(text)["A"]
    assert table.markdown(["b\\|c"], lambda row: row[0] != "y") == "| b\\|c |\n| --- |\n| **1** |"
    assert as_csv([table]) == "A,a,b|c\nA,x,1 [0–2]\nA,y,2\n"
