"""The README: short, and its figures are those of the committed report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

COLUMNS = ("random", "untrained", "talkingeyes_paper", "talkingeyes", "talkingeyes_events")
ROWS = {
    "Diversity of the eyes / truth": "unseen: Diversity of the eyes / truth",
    "99th percentile of eye speed / truth": "unseen: 99th percentile of eye speed / truth",
    "Eyes follow their sound / fitted motion": "unseen: tie of eyes to its sound / fitted motion",
    "Head follows its sound / fitted motion": "unseen: tie of head to its sound / fitted motion",
}


@pytest.fixture(scope="module")
def lines(repository: Path) -> list[str]:
    return (repository / "README.md").read_text().splitlines()


def test_it_is_short(lines: list[str]) -> None:
    assert len(lines) <= 80
    assert len(" ".join(lines).split()) <= 400


def test_figures_are_those_of_the_report(lines: list[str], repository: Path) -> None:
    report = json.loads((repository / "data" / "report" / "requirements.json").read_text())
    found = {name: {each["requirement"]: each for each in column} for name, column in report.items()}
    table = {
        cells[1].strip(): [each.strip() for each in cells[2:-1]]
        for cells in (line.split("|") for line in lines)
        if len(cells) > 3
    }
    for title, requirement in ROWS.items():
        assert table[title] == [f"{found[name][requirement]['value']:.2f}" for name in COLUMNS], title
    met = [f"{sum(each['met'] for each in report[name])} of {len(report[name])}" for name in COLUMNS]
    assert table["Requirements met"] == met
