"""`talkingeyes animate`, with a model that needs no training."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
import toy_motions
from command_line import call
from typer.main import get_command

import talkingeyes
from talkingeyes.animation import animator
from talkingeyes.animation.controls import Controls
from talkingeyes.audio.waveform import frame_count
from talkingeyes.cli import main as cli
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Blink, Events, Motion
from talkingeyes.rendering import traces
from talkingeyes.workflows.convert import FORMATS


class ToyPerformer:
    """Generator of motions that depend on seed, sample and length of the sound."""

    @classmethod
    def load(cls, model: Path) -> ToyPerformer:
        if not (model / "config.json").exists():
            raise InputError(f"{model}: not a trained model")
        return cls()

    def perform(
        self, sound: np.ndarray, samples: int, seed: int, fps: float, controls: Controls
    ) -> list[animator.Animation]:
        animations = []
        for index in range(samples):
            rng = np.random.default_rng([seed, index])
            frames = frame_count(len(sound), fps)
            motion = Motion.of(fps, rng.normal(0, 0.05, (frames, 3)), rng.normal(0, 0.05, (frames, 2, 3)))
            animations.append(animator.Animation(motion, Events(blinks=(Blink(0.1, 0.09, 0.02, 0.2, 1.0),))))
        return animations


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder with speech and a model."""
    monkeypatch.setattr(animator, "Animator", ToyPerformer)
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(0).normal(0, 0.1, (48_000, 2))
    soundfile.write(tmp_path / "my speech.wav", noise, 48_000)
    (tmp_path / "my speech.wav").rename(tmp_path / "my speech.txt")
    (tmp_path / "data" / "train" / "talkingeyes_events").mkdir(parents=True)
    (tmp_path / "data" / "train" / "talkingeyes_events" / "config.json").touch()
    return tmp_path


SAMPLE = (".events.json", ".mp4", ".npz")


@pytest.mark.parametrize("out", ["a/b/c d", "-dash", "\N{SNOWMAN}"])
def test_a_folder_may_have_any_name(place: Path, out: str) -> None:
    assert call("animate", "my speech.txt", "--out=" + out, "--samples", "1", "--no-previews") == 0
    names = sorted(path.name for path in (place / out).iterdir())
    assert names == ["manifest.json", "sample_00.events.json", "sample_00.npz"]


@pytest.mark.long
def test_animate_writes_every_sample_and_the_plot(place: Path) -> None:
    out = "out"
    assert call("animate", "my speech.txt", "--out=" + out, "--samples", "2", "--fps", "30") == 0
    names = sorted(path.name for path in (place / out).iterdir())
    samples = [f"sample_{index:02d}{suffix}" for index in (0, 1) for suffix in SAMPLE]
    assert names == ["manifest.json", *samples, "sheet.png", "traces.png"]
    motion = Motion.load(place / out / "sample_01.npz")
    assert (motion.fps, len(motion)) == (30.0, 30)
    assert len(Events.load(place / out / "sample_00.events.json").blinks) == 1
    assert not [path for path in (place / out).parent.iterdir() if "partial" in path.name]


def test_motions_are_there_before_their_films_and_an_interrupted_call_is_made_again(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(path: Path, *_: object) -> None:
        names = {each.name for each in path.parent.iterdir()}
        assert names == {"films.unfinished", "sample_00.events.json", "sample_00.npz", "sheet.png", "traces.png"}
        (path.parent / f".{path.name}.1.partial").touch()
        raise KeyboardInterrupt

    words = ["animate", "my speech.txt", "-o", "out", "--samples", "1"]
    with monkeypatch.context() as patched:
        patched.setattr("talkingeyes.rendering.video.write_video", interrupted)
        assert call(*words) == 130
    Motion.load(place / "out" / "sample_00.npz")
    monkeypatch.setattr("talkingeyes.rendering.video.write_video", lambda path, *_: path.touch())
    assert call(*words) == 0
    names = sorted(path.name for path in (place / "out").iterdir())
    assert names == ["manifest.json", *(f"sample_00{end}" for end in SAMPLE), "sheet.png", "traces.png"]
    assert capsys.readouterr().err.endswith("out/sample_00.mp4\n")
    assert call(*words) == 2  # a finished folder is kept


def test_other_formats_are_written_with_each_motion(place: Path) -> None:
    words = ["animate", "my speech.txt", "-o", "out", "--samples", "1", "--no-previews"]
    more = ["-f", "bvh", "-f", "events", "-f", "flame", "-f", "livelink"]
    assert call(*words, *more) == 0
    names = {path.name for path in (place / "out").iterdir()}
    assert {f"sample_00.{end}" for end in ("bvh", "keys.json", "flame.npz", "csv")} <= names
    assert call(*words, "--force") == 0
    assert not (place / "out" / "sample_00.bvh").exists()


def test_a_mesh_is_of_the_frame_that_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    toy_motions.motion().save(tmp_path / "a.npz")
    for frame in (0, 7):
        talkingeyes.export("a.npz", f"python_{frame}.ply", frame=frame)
    assert call("export", "a.npz", "-o", "first.ply") == 0
    assert call("export", "a.npz", "-f", "ply", "-o", "later.ply", "--frame", "7") == 0
    made = [(tmp_path / f"{name}.ply").read_bytes() for name in ("first", "later", "python_0", "python_7")]
    assert made[:2] == made[2:] and made[0] != made[1]


def test_help_of_export_names_every_format() -> None:
    options = {each.name: each.help for each in get_command(cli.app).commands["export"].params if each.name != "motion"}
    assert re.findall(r"\w+", options["format"].replace(" or ", " ")) == list(FORMATS)
    chosen = [name for name, each in FORMATS.items() if each.expression == "chosen"]
    named = options["head"].partition(":")[0].replace(" and ", " ")
    assert re.findall(r"\w+", named)[2:] == chosen


def test_python_api_gives_the_same_output(place: Path) -> None:
    silent = talkingeyes.animate_samples("my speech.txt", 2, seed=5)
    written = talkingeyes.animate_to_folder(place / "my speech.txt", place / "out", samples=2, seed=5, previews=False)
    for index in range(2):
        np.testing.assert_array_equal(silent[index].motion.gaze, written[index].motion.gaze)
        loaded = Motion.load(place / "out" / f"sample_{index:02d}.npz")
        np.testing.assert_allclose(loaded.head, written[index].motion.head, atol=1e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.wav", "-o", "out"], "none.wav: cannot be opened"),
        (["my speech.txt", "-o", "out", "--samples", "0"], "samples: should be 1 to 1000, got 0"),
        (["my speech.txt", "-o", "out", "--fps", "nan"], "fps: should be 10 to 240, got nan"),
        (["my speech.txt", "-o", "out", "--fps", "1000"], "fps: should be 10 to 240"),
        (["my speech.txt", "-o", "out", "--seed", "-1"], "seed: should be 0 or more"),
        (["my speech.txt", "-o", "out", "-f", "fbx"], "format: should be one of flame, vhap"),
        (["my speech.txt", "-o", "out", "--model", "other"], "other: not a trained model"),
        (["my speech.txt", "another.txt"], "out: should be the folder to write"),
        (["-o", "out"], "speech: should be sound files or --text, got neither"),
        (["my speech.txt", "--text", "Hello.", "-o", "out"], "speech: should be sound files or --text, got both"),
        (["my speech.txt", "--voice", "en-us+f3", "-o", "out"], "voice: should be used with --text"),
        (["--text", "...", "-o", "out"], "text: should hold words, got '...'"),
        (["--text", "Hello.", "--voice", "queen", "-o", "out"], "voice: should be accent+variant"),
        (["--text", "Hello.", "--voice", "de+f3", "--language", "fr", "-o", "out"], "of the language fr"),
        (["--text", "Hello.", "--language", "tlh", "-o", "out"], "language: should be one of en, fr"),
        (["my speech.txt", "-o", "out", "--target", "window"], "target: should be camera, listener or a file"),
        (["my speech.txt", "-o", "out", "--target", "none.json"], "none.json: not a readable track"),
        (["my speech.txt", "-o", "out", "--eye-contact", "2"], "eye_contact: should be 0"),
        (["my speech.txt", "-o", "out", "--head-liveliness", "-1"], "liveliness of head: should be 0"),
        (["my speech.txt", "-o", "out", "--partner", "none.wav"], "none.wav: cannot be opened"),
        (["my speech.txt", "-o", "out", "--style", "none.npz"], "none.npz: not a readable motion"),
        (["my speech.txt", "-o", "out", "--jobs", "0"], "jobs: should be 1 or more"),
        (["my speech.txt", "my speech.txt", "-o", "out"], "another sound is called my speech too"),
        (["data", "-o", "out"], "data: should hold sounds"),
        (["my speech.txt", "-o", "out", "--model", "data"], "not a trained model"),
        (["my speech.txt", "-o", "data"], "should be a new or empty folder"),
        (["my speech.txt", "-o", "data", "--force"], "should be a new or empty folder"),
        (["my speech.txt", "-o", "."], "should be a new or empty folder"),
        (["my speech.txt", "-o", "my speech.txt"], "should be a new or empty folder"),
        (["my speech.txt", "-o", "my speech.txt/out"], "should be in a writable folder"),
    ],
)
def test_bad_input_is_one_line_error_and_changes_nothing(
    place: Path, capfd: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    before = sorted(place.rglob("*"))
    assert call("animate", *words) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert sorted(place.rglob("*")) == before


def test_existing_output_is_replaced_only_with_force(place: Path) -> None:
    words = ["animate", "my speech.txt", "-o", "out", "--no-previews", "--samples"]
    assert call(*words, "2") == 0
    assert call(*words, "1") == 2
    assert (place / "out" / "sample_01.npz").exists()
    assert call(*words, "1", "--force") == 0
    assert not (place / "out" / "sample_01.npz").exists()


def test_failing_call_keeps_existing_output(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    talkingeyes.animate_to_folder("my speech.txt", "out", samples=1)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(traces, "plot_traces", full)
    with pytest.raises(InputError, match="No space left"):
        talkingeyes.animate_to_folder("my speech.txt", "out", samples=2, force=True)
    assert sorted(path.name for path in place.iterdir()) == ["data", "my speech.txt", "out"]
    assert not (place / "out" / "sample_01.npz").exists()


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; import talkingeyes.cli.main; print([m for m in sys.modules if m.split('.')[0] in %r])"
    heavy = ["torch", "numpy", "matplotlib", "scipy", "onnxruntime", "transformers", "mlflow", "av"]
    done = subprocess.run(
        [sys.executable, "-c", code % heavy], capture_output=True, text=True, check=True, env={**os.environ}
    )
    assert done.stdout.strip() == "[]"
