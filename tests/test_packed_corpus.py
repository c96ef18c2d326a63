"""The corpus that comes with the package, and the baseline of random motion beside any motion on it."""

from __future__ import annotations

import csv
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pipelines import benchmark_corpus
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.cli.main import app
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.packed import EVALUATORS, PACKAGED, STEP, pack_corpus, unpack_corpus
from talkingeyes.corpus.store import Corpus, shard_path

DOCS = Path(__file__).parents[1] / "docs/results"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Corpus:
    return unpack_corpus(PACKAGED, tmp_path_factory.mktemp("packed") / "corpus")


def test_the_package_has_sounds_and_true_motion(corpus: Corpus) -> None:
    sounds = {clip.sound: clip for clip in corpus.clips}
    assert len(sounds) == 84 and {clip.split for clip in corpus.clips} == {"unseen"}
    assert {clip.language for clip in corpus.clips} == {"en", "fr", "de", "es", "it", "pt", "nl"}
    for clip in list(sounds.values())[::20]:
        speech, motion = corpus.speech(clip), corpus.truth(clip)
        assert len(speech) == pytest.approx(clip.seconds * SAMPLE_RATE, abs=1) and np.abs(speech).max() > 0.05
        assert len(motion.head) == int(len(speech) * clip.fps) // SAMPLE_RATE and motion.lid.any()
        assert corpus.annotation(clip).speaking
    assert sum(corpus.partner(clip) is not None for clip in sounds.values()) > 30


def test_packing_again_gives_the_same_corpus(corpus: Corpus, tmp_path: Path) -> None:
    """With the first two sounds."""
    few, path = Corpus(tmp_path / "few"), tmp_path / "again.zip"
    few.root.mkdir()
    for each in corpus.root.iterdir():
        (few.root / each.name).symlink_to(each)
    (few.root / "clips.parquet").unlink()
    few.write_index(corpus.clips[:6])
    pack_corpus(few, corpus.root / EVALUATORS, path)
    pack_corpus(few, corpus.root / EVALUATORS, tmp_path / "same.zip")
    assert path.read_bytes() == (tmp_path / "same.zip").read_bytes()
    with zipfile.ZipFile(path) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    again = unpack_corpus(path, tmp_path / "again")
    assert again.clips == corpus.clips[:6]
    files = [{path.relative_to(each.root) for path in each.root.rglob("*.*")} for each in (corpus, again)]
    assert files[0] > files[1] and Path(EVALUATORS, "critic", "head", "model.safetensors") in files[1]
    for clip in again.clips:
        one, other = corpus.truth(clip), again.truth(clip)
        for name in ("head", "gaze", "lid", "valid"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert np.all(one.head % STEP == 0)
        assert again.conversation(clip) == corpus.conversation(clip)


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="should be a new or empty folder"):
        unpack_corpus(PACKAGED, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.long
def test_random_motion_fails_what_follows_the_sound(corpus: Corpus, tmp_path: Path) -> None:
    """The second takes, measured as motions of a system: truth passes what random motion does not."""
    motions = tmp_path / "motions"
    motions.mkdir()
    for clip in corpus.clips:
        if clip.take == 1:
            (motions / f"{clip.sound}.npz").symlink_to(shard_path(corpus.root / "truth", clip.id, ".npz").resolve())
    command = ["evaluate", str(motions), "--reference", str(corpus.root), "-o", str(tmp_path / "figures")]
    command += ["--evaluators", str(corpus.root / EVALUATORS), "--n-resamples", "200"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "random is the true motion of other speakers under other sounds: it is worse in " in done.output
    entries = json.loads((tmp_path / "figures" / "benchmark.json").read_text())["metrics"]
    failed = {name for name, entry in entries.items() if entry["random_worse"]}
    assert {"speech_onset/drop", "turn_start/rise", "head/speech_speed_ratio", "blinks/at_phrase_ends"} <= failed
    assert {f"corr/{part}_minus_shuffled" for part in ("gaze", "gaze_in_space", "head")} <= failed
    assert not failed & {"saccades/rate", "eye/speed", "gaze_in_space/still_fraction", "partner_gaze/fraction"}
    assert sum(bool(entries[name]["worse"]) for name in failed) <= 2
    with (tmp_path / "figures" / "benchmark.csv").open(newline="") as file:
        lines = {line["metric"]: line for line in csv.DictReader(file)}
    assert float(lines["eye/speed"]["random"]) == pytest.approx(entries["eye/speed"]["random"]["value"], rel=1e-5)
    assert lines["turn_start/rise"]["random_worse"] == "true"


def test_a_file_in_place_of_a_folder_is_one_line() -> None:
    done = CliRunner().invoke(app, ["benchmark-corpus", str(PACKAGED)])
    assert isinstance(done.exception, InputError)


def test_the_page_is_of_the_numbers() -> None:
    numbers = json.loads((DOCS / "benchmark_corpus.json").read_text())
    assert (DOCS / "benchmark_corpus.md").read_text() == benchmark_corpus.page(numbers)
