"""Reference ranges of a model: its motion at two frame rates, and the truth."""

import csv

import numpy as np
import pytest

from pipelines import reference_ranges_model
from talkingeyes.evaluation.reference_ranges.clip_data import measurement, no_measurement
from talkingeyes.evaluation.reference_ranges.range_class import RANGE_CLASSES
from talkingeyes.evaluation.reference_ranges.ranges import REFERENCE_RANGES


@pytest.mark.long
def test_model_is_compared_with_ranges_and_truth(tiny, monkeypatch, capsys):
    monkeypatch.chdir(tiny)
    monkeypatch.setattr(reference_ranges_model, "SAMPLES", 2)
    monkeypatch.setattr(reference_ranges_model, "MAIN_SEQUENCE_FPS", 250.0)
    monkeypatch.setattr("sys.argv", ["reference_ranges_model", "vae", "--split", "test"])
    reference_ranges_model.main()
    said = capsys.readouterr().out.removesuffix("\n")
    page = (tiny / "build/reference_ranges/vae-test.md").read_text()
    assert page.partition("## ")[0] == said.partition("## ")[0]
    outside = [line for line in said.splitlines() if any("**outside**" in cell for cell in line.split(" | ")[4:7])]
    shown = page.partition("## Outside the range")[2]
    without_reasons = [reference_ranges_model.REASON.sub("| - ", line) for line in outside]
    assert without_reasons == [line for line in shown.splitlines() if "**outside**" in line] != []
    rows = {row.split(" | ")[0].removeprefix("| "): row.split(" | ")[4:] for row in said.splitlines() if " | " in row}
    everything = (tiny / "build/reference_ranges/vae-test.csv").read_text()
    lines = [line for line in said.partition("## Statistics")[2].splitlines() if line.startswith("|")]
    assert len(list(csv.reader(everything.splitlines()))) == len(lines) - 1  # the rule under the headings
    values = dict(zip(reference_ranges_model.COLUMNS, rows["mean speed of eye-in-head, 25 fps, deg/s"], strict=True))
    assert len({values[each].split()[0] for each in ("25 fps", "Random", "Untrained", "truth, 25 fps")}) == 4
    # The same motion at two rates: the head is as wide.
    wide = rows["head within a clip: yaw SD, deg"]
    assert float(wide[0].split()[0]) == pytest.approx(float(wide[1].split()[0]), rel=0.05)
    assert any(row.startswith("style") for row in rows)
    ties = page.partition("## Sound and motion")[2].partition("## Outside")[0]
    for row in ("sound to averted state", "variance between takes / total, same sound: eye"):
        assert f"| {row}" in ties
    assert "matched / mismatched sound" in everything, "a tiny corpus has too few sounds for it; the CSV file says so"
    assert not any(row.startswith("jaw") for row in rows)


def test_half_minutes_of_a_style_are_of_several_sounds():
    samples = reference_ranges_model.SAMPLES
    sound = np.repeat(np.arange(3), samples)
    taken = reference_ranges_model.order_by_take({"style.looking": sound, "blinks": sound})
    np.testing.assert_array_equal(taken["style.looking"], np.tile(np.arange(3), samples))
    np.testing.assert_array_equal(taken["blinks"], sound)


def test_value_outside_its_range_is_marked():
    fact = next(each for each in REFERENCE_RANGES if each.name == "rate")
    assert reference_ranges_model.cell(fact, measurement(1.5, 40, "saccades")) == "1.5"
    assert reference_ranges_model.cell(fact, measurement(3.5, 40, "saccades")) == "3.5 **outside**"
    assert reference_ranges_model.cell(fact, no_measurement("too few")) == "- (too few)"
    found = {"rate": measurement(3.5, 40, "saccades"), "below_5": measurement(0.5, 40, "saccades")}
    assert reference_ranges_model.counts(found) == "1 within, 1 outside"
    assert reference_ranges_model.counts(found, learnt=True) == "0 within, 1 outside", "below_5 is corrected"


def test_every_range_with_a_class_exists():
    assert {name for names in RANGE_CLASSES.values() for name in names} <= {each.name for each in REFERENCE_RANGES}
