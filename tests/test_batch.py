"""Batch animation: resumable, output independent of the number of jobs, and a table with the status of each sound."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from command_line import call
from toy_model import sound_file, toy_model

import talkingeyes
from talkingeyes.animation.controls import Controls
from talkingeyes.animation.conversation_states import StateTrack
from talkingeyes.animation.targets import constant_target
from talkingeyes.audio.annotation import Span
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.workflows import animate as animation
from talkingeyes.workflows.animate import AnimationOptions
from talkingeyes.workflows.animate_batch import animate_all, derive_seed

ORDER = AnimationOptions(samples=1, seed=4, previews=False)
pytestmark = pytest.mark.usefixtures("models_loaded_once")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with three sounds and a model."""
    monkeypatch.chdir(tmp_path)
    toy_model(tmp_path / "data" / "train" / "talkingeyes_events")
    (tmp_path / "lines").mkdir()
    for index, name in enumerate(("b", "a", "c")):
        sound_file(tmp_path / "lines" / f"{name}.wav", 1.0 + index / 4, seed=index)
    return tmp_path


def files(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "summary.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_manifest_with_open_ends_is_strict_json_and_is_recognised(place: Path) -> None:
    states = StateTrack((Span(0.0, 0.5, "thinking"), Span(0.5, math.inf, "idle")))
    order = replace(ORDER, controls=Controls(targets=constant_target("camera"), states=states))
    assert [line.status for line in animate_all(["lines"], "out", order)] == ["done"] * 3
    text = (place / "out" / "a" / "manifest.json").read_text()

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    controls = json.loads(text, parse_constant=refuse)["controls"]
    assert [each["end_s"] for each in controls["states"]["spans"]] == [0.5, None]
    assert [each["end_s"] for each in controls["targets"]["targets"]] == [None]
    assert [line.status for line in animate_all(["lines"], "out", order)] == ["skipped"] * 3
    closed = replace(states, spans=(states.spans[0], Span(0.5, 0.9, "idle")))
    other = replace(order, controls=replace(order.controls, states=closed))
    assert [line.status for line in animate_all(["lines"], "out", other, force=True)] == ["done"] * 3


def test_each_sound_has_a_folder_and_a_row(place: Path) -> None:
    lines = animate_all(["lines"], "out", ORDER)
    rows = table(place / "out")
    assert [row["file"] for row in rows] == ["a.wav", "b.wav", "c.wav"]
    assert list(rows[0]) == ["file", "seconds", "samples", "seed", "status", "reason"]
    assert [(float(row["seconds"]), row["status"]) for row in rows] == [(1.25, "done"), (1.0, "done"), (1.5, "done")]
    assert json.loads((place / "out" / "summary.json").read_text()) == [vars(line) for line in lines]
    assert len({row["seed"] for row in rows}) == 3
    alone = talkingeyes.animate(place / "lines" / "a.wav", seed=lines[0].seed)
    found = Motion.load(place / "out" / "a" / "sample_00.npz")
    np.testing.assert_allclose(found.gaze, alone.motion.gaze, atol=1e-6)


@pytest.mark.long
def test_output_is_independent_of_jobs_and_order(place: Path) -> None:
    sounds = sorted((place / "lines").iterdir())
    animate_all(sounds, "one", AnimationOptions(samples=2, seed=4, formats=("bvh",), previews=False))
    animate_all(sounds[::-1], "two", AnimationOptions(samples=2, seed=4, formats=("bvh",), previews=False), jobs=2)
    assert files(place / "one") == files(place / "two")


def test_second_run_keeps_finished_and_makes_new_sounds(place: Path) -> None:
    animate_all(["lines"], "out", ORDER)
    before = files(place / "out" / "b")
    stamps = {path: path.stat().st_mtime_ns for path in (place / "out").glob("*/*.npz")}
    sound_file(place / "lines" / "d.wav")
    lines = animate_all(["lines"], "out", ORDER)
    assert [(line.file, line.status) for line in lines] == [
        ("a.wav", "skipped"),
        ("b.wav", "skipped"),
        ("c.wav", "skipped"),
        ("d.wav", "done"),
    ]
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    sound_file(place / "lines" / "b.wav", seed=9)  # the sound has changed
    assert [line.status for line in animate_all(["lines"], "out", ORDER)] == ["skipped", "failed", "skipped", "skipped"]
    assert files(place / "out" / "b") == before
    assert [line.status for line in animate_all(["lines"], "out", ORDER, force=True)] == [
        "skipped",
        "done",
        "skipped",
        "skipped",
    ]
    assert files(place / "out" / "b") != before


@pytest.mark.parametrize("change", [{"seed": 5}, {"samples": 2}, {"fps": 60.0}, {"formats": ("bvh",)}])
def test_changed_options_are_not_taken_as_finished(place: Path, change: dict[str, object]) -> None:
    animate_all(["lines/a.wav"], "out", ORDER)
    changed = AnimationOptions(**{"samples": 1, "seed": 4, "previews": False} | change)  # type: ignore[arg-type]
    assert [line.status for line in animate_all(["lines/a.wav"], "out", changed)] == ["failed"]
    assert [line.status for line in animate_all(["lines/a.wav"], "out", changed, force=True)] == ["done"]


def test_failures_do_not_stop_the_others(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    soundfile.write(place / "lines" / "b.wav", np.zeros(16_000), 16_000)
    (place / "lines" / "d.wav").write_bytes(b"no sound")
    assert call("animate", "lines", "-o", "out", "--samples", "1", "--no-previews") == 2
    said = capfd.readouterr()
    assert said.out == "out: 2 done, 2 failed; head and gaze: data/train/talkingeyes_events, face: packaged\n"
    assert "error: 2 of 4 failed (out/summary.csv); the first: lines/b.wav: silent" in said.err
    rows = table(place / "out")
    assert [row["status"] for row in rows] == ["done", "failed", "done", "failed"]
    assert "not a sound that can be decoded" in rows[3]["reason"]
    assert not (place / "out" / "b").exists()


def test_unexpected_error_is_a_row(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(animation, "write_animation", broken)
    (line,) = animate_all(["lines/a.wav"], "out", ORDER)
    assert (line.status, line.reason) == ("failed", "RuntimeError: two lines")


def test_leftovers_of_a_killed_run_are_removed_and_other_files_kept(place: Path) -> None:
    animate_all(["lines"], "out", ORDER)
    (place / "out" / ".a.123.partial").mkdir()
    animate_all(["lines"], "out", ORDER)
    assert not (place / "out" / ".a.123.partial").exists()
    (place / "out" / "letters").mkdir()
    with pytest.raises(InputError, match="or that of an earlier run, got letters in it"):
        animate_all(["lines"], "out", ORDER)


def test_missing_model_is_an_error_before_any_output(place: Path) -> None:
    with pytest.raises(InputError, match="no trained model here"):
        animate_all(["lines"], "out", ORDER, model="none")
    assert not (place / "out").exists()


def test_seeds_depend_on_the_sound(place: Path) -> None:
    one, other = (read_speech(place / "lines" / f"{name}.wav") for name in "ab")
    assert derive_seed(1, one) == derive_seed(1, one.copy())
    assert len({derive_seed(1, one), derive_seed(1, other), derive_seed(2, one)}) == 3
