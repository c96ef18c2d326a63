"""The README: short, its figures are those of the committed report, and its commands in their order lose no part."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from pipelines.results.result_tables import read_tables
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL
from talkingeyes.core.motion import Motion
from talkingeyes.workflows.serve import find_live_model

COLUMNS = ("random", "untrained", "aligned_replay", "talkingeyes_paper", "talkingeyes_events")
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
    for title, kind in (("Ties to speech, met", "tie"), ("Margins of motion, met", "margin")):
        met = [[each["met"] for each in report[name] if each["kind"] == kind] for name in COLUMNS]
        assert table[title] == [f"{sum(each)} of {len(each)}" for each in met]


def test_figures_of_the_release_are_those_of_its_report(lines: list[str], repository: Path) -> None:
    newest = (repository / "docs/results/releases.md").read_text().split("\n## ")[-1]
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


def test_every_part_moves_before_and_after_make_repro(repository: Path, tiny: Path, tmp_path: Path) -> None:
    """`make repro` trains no face: `animate` and `serve` in its folder then take the packaged one."""
    rng = np.random.default_rng(0)
    level = np.repeat(rng.uniform(0, 0.3, 24), 4000)  # syllables and pauses
    soundfile.write(tmp_path / "speech.wav", level * rng.standard_normal(level.size), 16_000)
    said = [_animate(tmp_path, "before")]
    makefile = (repository / "Makefile").read_text()
    rows = re.search(r"^REPRO = (.*)$", makefile, re.M).group(1).split()[3:]  # type: ignore[union-attr]
    (tmp_path / "data" / "train").mkdir(parents=True)
    for row in rows:
        if not row.startswith("$"):
            (tmp_path / "data" / "train" / row).symlink_to(tiny / "data" / "train" / row)
    said.append(_animate(tmp_path, "after", "--emotion", "happy"))
    assert said[0].endswith("; head, gaze and face: the packaged model\n")
    assert said[1].endswith("; head and gaze: data/train/talkingeyes_events, face: packaged\n")
    assert find_live_model(tmp_path / "data" / "train" / "talkingeyes_events", None) == PACKAGED_LIVE_MODEL


def _animate(folder: Path, out: str, *options: str) -> str:
    """The line that `animate` prints; all parts of its motion move."""
    command = [sys.executable, "-m", "talkingeyes.cli.main", "animate", "speech.wav", "-o", out, "--samples", "1"]
    command += ["--no-previews", *options]
    done = subprocess.run(command, check=False, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    motion = Motion.load(folder / out / "sample_00.npz")
    for name in ("head", "gaze", "lid", "jaw", "expression"):
        assert np.ptp(getattr(motion, name), axis=0).max() > 0.01, f"{out}: {name} moves"
    return done.stdout
