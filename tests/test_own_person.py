"""Models of one person: the split in time, the comparison of styles, and the whole command on a synthetic person."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talkingeyes.corpus.splits import split_in_time
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.papers.posegan_movement import ClipStyle, compare_styles

SETTINGS = BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0)
SHORT = ("loop.steps=4", "loop.validate_every=4", "loop.batch=4", "validation_clips=2")


@given(st.lists(st.floats(0.1, 1000), min_size=3, max_size=30))
def test_one_person_is_split_in_time(lengths: list[float]) -> None:
    split = list(split_in_time({str(place): each for place, each in enumerate(lengths)}).values())
    assert split == sorted(split, key=["train", "val", "test"].index)
    assert set(split) == {"train", "val", "test"}


def test_ten_equal_clips_are_eight_one_and_one() -> None:
    assert list(split_in_time(dict.fromkeys("abcdefghij", 10.0)).values()) == ["train"] * 8 + ["val", "test"]


def motion(size: float, tempo: float, clip: int) -> ClipStyle:
    rng, time = np.random.default_rng(clip), np.arange(500) / 25
    waves = [np.sin(2 * np.pi * tempo * time * rng.uniform(0.9, 1.1) + rng.uniform(0, 6)) for _ in range(9)]
    angles = 0.1 * size * np.stack(waves, axis=-1)
    return ClipStyle.of(angles[None, :, :3], np.repeat(angles[None, :, None, 3:6], 2, axis=2))


def test_style_is_near_for_the_same_person_and_tells_size_and_tempo() -> None:
    person = [motion(1, 0.5, clip) for clip in range(6)]
    same, larger, faster = (
        compare_styles([motion(size, tempo, clip) for clip in range(10, 16)], person, SETTINGS, same_clips=True)["head"]
        for size, tempo in ((1, 0.5), (2, 0.5), (1, 1))
    )
    assert same.distance.value < 0.1 < larger.distance.value
    assert 1.9 < larger.range.value < 2.1 and 1.9 < larger.speed.value < 2.1
    assert 0.9 < faster.range.value < 1.1 and 1.8 < faster.speed.value < 2.2
    assert larger.range.low <= larger.range.value <= larger.range.high


@pytest.fixture(scope="module")
def person(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus of one speaker, as `talkingeyes track` splits it."""
    whole, root = tiny / "data" / "synthesize", tmp_path_factory.mktemp("person")
    for part in whole.iterdir():
        if part.is_dir():
            (root / part.name).symlink_to(part.resolve())
    clips = [clip for clip in Corpus(whole).clips if clip.take == 0 and clip.split != "unseen"]
    own = [clip for clip in clips if clip.speaker == clips[0].speaker]
    split = split_in_time({clip.id: clip.seconds for clip in own})
    Corpus(root).write_index([replace(clip, split=split[clip.id]) for clip in own])
    return root


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pipelines.results.own_person", *arguments],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.long
def test_models_of_one_person_are_trained_measured_and_used(person: Path, tmp_path: Path) -> None:
    short = [f"model.{name}.{each}" for name in ("posegan", "own_person") for each in SHORT]
    windows = ["model.posegan.windows.frames=128", "model.posegan.head.window=128"]
    ended = command(str(person), "fit=tiny", "sample.samples=2", f"workspace={tmp_path}/own", *short, *windows)
    assert ended.returncode == 0, ended.stderr[-3000:]
    page = (tmp_path / "own" / "own_person.md").read_text()
    assert ended.stdout.strip() == page.strip()
    for row in ("recorded: the part for training", "the default, trained on", "PoseGAN's head", "the packaged default"):
        assert f"| {row}" in page
    assert "nan" not in page


@pytest.mark.long
def test_other_corpora_are_refused_in_one_line(tiny: Path, person: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    Corpus(few).write_index([clip for clip in Corpus(person).clips if clip.split != "test"])
    for arguments, error in (
        ([str(tiny / "data" / "synthesize")], "should hold clips of one person"),
        ([str(few)], "should have three clips or more, got none for test"),
        (["train.seed=1"], "CORPUS: should be a folder of `talkingeyes track`, got none"),
        ([str(tmp_path / "none")], "clips.parquet"),
    ):
        ended = command(*arguments, f"workspace={tmp_path}/refused")
        assert ended.returncode == 2
        assert error in ended.stderr
        assert len(ended.stderr.splitlines()) == 1
    assert not (tmp_path / "refused").exists()
