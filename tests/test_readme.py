"""The README: short, and its figures are those of the committed report."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pipelines.result_tables import read_tables

COLUMNS = ("random", "untrained", "talkingeyes_paper", "talkingeyes", "talkingeyes_events")
ROWS = {
    "Diversity of the eyes / truth": "unseen: Diversity of the eyes / truth",
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
    for title, ties in (("Ties to speech, met", True), ("Margins of motion, met", False)):
        met = [[each["met"] for each in report[name] if each["tie"] == ties] for name in COLUMNS]
        assert table[title] == [f"{sum(each)} of {len(each)}" for each in met]


def test_figures_of_the_release_are_those_of_its_report(lines: list[str], repository: Path) -> None:
    newest = (repository / "docs" / "releases.md").read_text().split("\n## ")[-1]
    tables = read_tables(newest)
    timing, required = tables["Averted gaze around events of speech"], tables["Requirements"]

    def figure(table, first: str, column: str) -> float:  # type: ignore[no-untyped-def]
        place = next(at for at, name in enumerate(table.columns) if name.startswith(column))
        cell = next(row for row in table.rows if row[0].startswith(first))[place]
        return float(cell.replace("**", "").split()[0])

    rise = [figure(timing, "averted at speech onsets, rise", name) for name in ("TalkingEyes, events", "Truth")]
    fall = figure(required, "drop of averted gaze after speech onsets", "TalkingEyes, events")
    stated = re.search(r"rises (\S+) and falls (\S+) times as much as the truth's", " ".join(lines))
    assert stated and stated.groups() == (f"{rise[0] / rise[1]:.2f}", f"{fall:.2f}")
    information = tables["Information of speech about averted gaze, nats per second"]
    known = [
        float(next(row[1] for row in information.rows if row[0].startswith(name)).split()[0])
        for name in ("TalkingEyes, events", "Truth")
    ]
    assert f"speech tells {known[0] / known[1]:.2f} as much about it" in " ".join(lines)
