"""`talkingeyes evaluate`: file names, output, and errors for bad input."""

from __future__ import annotations

import json

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError, validate
from test_inference import without_extras
from toy_people import ANNOTATION, ToyPerson, people_csv
from typer.testing import CliRunner

from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.cli import main
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_files import clip_id_of, read_motions
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.evaluation.benchmark.registry import VERSION, json_schema
from talkingeyes.workflows.convert import export
from talkingeyes.workflows.evaluate import benchmark_text, evaluate

CLIPS = 4


def motion(seed: int, fps: float = 25.0) -> Motion:
    made = ToyPerson(seed).at(fps)
    return Motion.of(fps, made.head, made.gaze, lid=made.lid)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """Four sounds with their true motion."""
    root = tmp_path_factory.mktemp("corpus")
    clips = []
    for seed in range(CLIPS):
        name = f"c{seed}"
        made = motion(seed)
        clips.append(
            Clip(f"{name}-t0", name, 0, "a", "test", made.seconds, 25.0, "", 0, "en", "", "toy", "CC0-1.0", "")
        )
        ANNOTATION.save(make_shard_path(root / "annotations", name, ".json"))
        made.save(make_shard_path(root / "truth", f"{name}-t0", ".npz"))
    Corpus(root).write_index(clips)
    return root


def values(found):
    return {row.metric.name: row for row in found.rows}


def test_truth_against_itself_writes_table_and_plot(corpus, tmp_path):
    found = evaluate(corpus / "truth", corpus, tmp_path / "out", n_resamples=20)
    assert found.paired and found.sounds == CLIPS
    assert values(found)["saccades/rate"].reason == ""
    assert values(found)["saccades/rate"].difference.value == 0
    assert values(found)["saccades/amplitude"].reason == "needs 50 saccades: the motions have 47"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"benchmark.json", "benchmark.csv", "strip.png"}
    written = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert written["sounds"] == CLIPS
    assert written["benchmark_version"] == VERSION
    validate(written, json_schema())
    assert found.notes == ["intervals are over sounds and too narrow for 4; use 10 or more"]
    assert "4 sounds at 25 fps, compared with the truth under the same sounds" in benchmark_text(found)
    with pytest.raises(InputError, match="--force"):
        evaluate(corpus / "truth", corpus, tmp_path / "out", n_resamples=20)


def test_schema_is_printed_and_rejects_other_contents(corpus, tmp_path):
    printed = CliRunner().invoke(main.app, ["evaluate", "--schema"])
    assert printed.exit_code == 0
    schema = json.loads(printed.stdout)
    Draft202012Validator.check_schema(schema)
    evaluate(corpus / "truth", corpus, tmp_path / "out", n_resamples=20)
    good = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    validate(good, schema)
    rate = good["metrics"]["saccades/rate"]
    bad = (
        {key: value for key, value in good.items() if key != "benchmark_version"},
        {**good, "schema": "talkingeyes.benchmark/2"},
        {**good, "score": 1.0},
        {**good, "metrics": {"saccades/rate": {**rate, "direction": "up"}}},
        {**good, "metrics": {"saccades/rate": {**rate, "value": 1.0}}},
    )
    for each in bad:
        with pytest.raises(ValidationError):
            validate(each, schema)


@pytest.mark.long
def test_files_of_another_program_are_measured_without_torch_and_models(corpus, tmp_path):
    """Live Link tables go through `import` and `evaluate` in the base installation, against a corpus and people."""
    people_csv(tmp_path / "people.csv")
    (tmp_path / "takes").mkdir()
    for seed in range(CLIPS):
        export(motion(20 + seed), tmp_path / "takes" / f"c{seed}-t0.csv")
    against = ("--reference", str(corpus), "--n-resamples", "20")
    for arguments in (
        ("import", "takes", "-o", "motions", "--fps", "25"),
        ("evaluate", "motions", *against, "-o", "out"),
        ("evaluate", "motions", *against, "--people", "people.csv", "-o", "people"),
    ):
        done = without_extras(tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
    measured = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert measured["sounds"] == CLIPS
    assert measured["metrics"]["saccades/rate"]["value"]["value"] > 0.2
    assert (tmp_path / "people" / "people.json").is_file()


def test_samples_unknown_and_broken_files(corpus, tmp_path):
    motions = tmp_path / "motions"
    (motions / "c1-t0").mkdir(parents=True)
    motion(10).save(motions / "c0-t0-s0.npz")
    motion(11).save(motions / "c0-t0-s1.npz")
    motion(12).save(motions / "c1-t0" / "sample_00.npz")
    motion(13).save(motions / "stranger.npz")
    (motions / "c2-t0.npz").write_bytes(b"no zip")
    made = motion(14)
    gaze = made.gaze.copy()
    gaze[10:20] = np.nan
    np.savez(motions / "c3-t0.npz", fps=25.0, gaze=np.stack([gaze, made.gaze]))
    found = evaluate(motions, corpus, n_resamples=20)
    assert found.sounds == 3
    assert any("c2-t0.npz" in note for note in found.notes)
    assert any("1 of 5 names are not clips" in note for note in found.notes)


def test_motions_for_other_sounds_are_compared_with_all_truth(corpus, tmp_path):
    motion(20).save(tmp_path / "mine.npz")
    found = evaluate(tmp_path, corpus, n_resamples=20)
    assert not found.paired
    assert values(found)["speech_onset/rise"].reason == "needs annotation: missing in the motions"
    assert values(found)["eye/still_fraction"].reason.startswith("needs 1500 frames: the motions have 299")


def test_other_rates_are_compared_where_possible(corpus, tmp_path):
    motion(0, 60.0).save(tmp_path / "c0-t0.npz")
    motion(1, 60.0).save(tmp_path / "c1-t0.npz")
    assert evaluate(tmp_path, corpus, n_resamples=20).fps == 60
    motion(2, 50.0).save(tmp_path / "c2-t0.npz")
    with pytest.raises(InputError, match="the motions should have one frame rate, got 60 and 50"):
        evaluate(tmp_path, corpus, n_resamples=20)


def test_mistakes_are_one_line(corpus, tmp_path):
    with pytest.raises(InputError, match=r"should hold motion files .*`talkingeyes import`"):
        evaluate(tmp_path, corpus)
    with pytest.raises(InputError, match="nowhere: should be a corpus, got no folder; `dvc repro synthesize`"):
        evaluate(tmp_path, tmp_path / "nowhere")
    with pytest.raises(InputError, match="should be a folder, got none"):
        evaluate(tmp_path / "nowhere", corpus)
    with pytest.raises(InputError, match="should contain true motion"):
        evaluate(tmp_path, tmp_path)
    np.savez(tmp_path / "c0-t0.npz", fps=25.0)
    with pytest.raises(InputError, match="should hold a usable motion, got none"):
        evaluate(tmp_path, corpus)


@pytest.mark.parametrize(
    ("path", "name"),
    [("a/x-t0.npz", "x-t0"), ("a/x-t0-s3.npz", "x-t0"), ("a/x_sample_03.npz", "x"), ("a/sample_03.npz", "a")],
)
def test_file_names_give_the_clip(tmp_path, path, name):
    assert clip_id_of(tmp_path / path) == name


def test_number_of_samples_must_agree(tmp_path):
    np.savez(tmp_path / "x.npz", fps=25.0, head=np.zeros((2, 50, 3)), gaze=np.zeros((3, 50, 2, 3)))
    with pytest.raises(InputError, match="the same number of samples"):
        list(read_motions(tmp_path / "x.npz"))


def test_speech_is_detected_by_level():
    sound = np.random.default_rng(0).normal(0, 1e-4, 16000 * 6).astype(np.float32)
    for start, end in ((1.0, 2.0), (2.1, 3.0), (4.0, 5.0)):
        sound[int(start * 16000) : int(end * 16000)] *= 1000
    spans = detect_speech(sound).speaking
    assert [(round(span.start_s, 1), round(span.end_s, 1)) for span in spans] == [(1.0, 3.0), (4.0, 5.0)]
