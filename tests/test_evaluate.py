"""The stages `critic` and `evaluate` on an artificial workspace, and the metrics of one clip."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from jsonschema import validate
from toy_workspace import FRAMES, toy_workspace

from pipelines import critic, evaluate
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.registry import VERSION, json_schema
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.measures.corr import CorrScores
from talkingeyes.evaluation.papers.talkingeyes_metrics import EvaluationCase, clip_metrics, summarise
from talkingeyes.evaluation.report.emotion import (
    EMOTION_FILE,
    EmotionalSound,
    emotion_recognised,
    fit_classifier,
    head_gaze_features,
)
from talkingeyes.models.contrastive_critic import CRITIC_PARTS
from talkingeyes.physiology.blinks import PHYSIOLOGICAL
from talkingeyes.synthesis.speakers import sample_style
from talkingeyes.synthesis.take import sample_take
from talkingeyes.workflows.evaluate import evaluate as compare

ROWS = ("truth", "fitted", "mismatched", "mean", "random")
BOOTSTRAP = BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    made = toy_workspace(tmp_path_factory.mktemp("workspace"))
    critic.run(made)
    for row in ROWS:
        evaluate.run(made, row)
    return made


@pytest.fixture(scope="module")
def tables(workspace):
    return {row: json.loads(workspace.data("evaluate", row, "metrics.json").read_text()) for row in ROWS}


@pytest.mark.long
def test_critic_reports_both_aucs_and_the_corr_of_baselines(workspace):
    report = json.loads(workspace.data("critic", "report.json").read_text())
    assert set(report) == set(CRITIC_PARTS)
    for part in CRITIC_PARTS:
        names = {path.name for path in workspace.data("critic", part).iterdir()}
        assert names == {"model.safetensors", "config.json", "history.json"}
        assert set(report[part]) == {"held_out", "test", "unseen", "test_and_unseen"}
        for verdict in report[part].values():
            assert set(verdict) == {
                "auc_same_speaker", "auc_all", "corr_truth", "corr_shuffled", "corr_constant", "corr_minus_shuffled",
            }  # fmt: skip
            assert all(each["low"] <= each["high"] for each in verdict.values())


def test_every_row_has_every_split_part_and_metric(tables):
    distances = {"diversity", "diversity_multi_take", "diversity_ratio", "diversity_ratio_fitted", "l2"}
    others = {
        "corr",
        "corr_minus_fitted",
        "corr_shuffled",
        "corr_minus_shuffled",
        "speed",
        "speed_ratio",
        "speed_p99",
        "speed_p99_ratio",
        "still_fraction",
    }
    for row, table in tables.items():
        wanted = others - ({"corr_shuffled", "corr_minus_shuffled"} if row == "mismatched" else set())
        assert set(table) == {"test", "unseen"}
        for parts in table.values():
            assert {part: set(figures) for part, figures in parts.items()} == {
                "gaze": distances | wanted, "gaze_in_space": wanted, "head": distances | wanted,
            }  # fmt: skip


def test_references_compare_with_themselves(tables):
    for parts in tables["truth"].values():
        for part in ("gaze", "head"):
            assert parts[part]["diversity_ratio"] == dict.fromkeys(
                ("value", "low", "high", "speakers_low", "speakers_high"), 1.0
            )
            assert parts[part]["speed_ratio"]["value"] == parts[part]["speed_p99_ratio"]["value"] == 1.0
        assert tables["fitted"]["test"]["gaze_in_space"]["corr_minus_fitted"]["value"] == 0.0


def test_mean_has_no_diversity_and_is_still(tables):
    for parts in tables["mean"].values():
        for part in ("gaze", "head"):
            assert parts[part]["diversity"]["value"] == parts[part]["diversity_ratio"]["value"] == 0
            assert parts[part]["speed"]["value"] == 0
            assert parts[part]["still_fraction"]["value"] == 1
            assert parts[part]["l2"]["value"] > 0


def test_row_is_independent_of_jobs(workspace, tables, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluate, "SOUNDS_PER_PROCESS", 1)
    parallel = toy_workspace(tmp_path, jobs=2)
    shutil.copytree(workspace.data("critic"), parallel.data("critic"))
    evaluate.run(parallel, "mismatched")
    for name in ("metrics.json", "speed.csv"):
        files = [each.data("evaluate", "mismatched", name).read_bytes() for each in (workspace, parallel)]
        assert files[0] == files[1]


def test_speeds_fall_from_one_to_zero(workspace):
    lines = workspace.data("evaluate", "truth", "speed.csv").read_text().splitlines()[1:]
    shares = [float(line.split(",")[2]) for line in lines if line.startswith("gaze,")]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.99
    assert shares[-1] == 0


def test_a_corpus_without_truth_has_an_empty_row_truth(workspace, tmp_path):
    tracked = toy_workspace(tmp_path)
    (tracked.corpus / "truth").rename(tracked.corpus / "elsewhere")
    shutil.copytree(workspace.data("critic"), tracked.data("critic"))
    evaluate.run(tracked, "truth")
    assert json.loads(tracked.data("evaluate", "truth", "metrics.json").read_text()) == {"test": {}, "unseen": {}}
    evaluate.run(tracked, "fitted")
    table = json.loads(tracked.data("evaluate", "fitted", "metrics.json").read_text())
    assert table["test"]["gaze"]["speed_ratio"]["value"] == 1


def test_the_command_takes_corr_from_the_networks_of_the_chain(workspace):
    truth = workspace.corpus / "truth"
    found = {
        name: {
            row.metric.name: row for row in compare(truth, workspace.corpus, evaluators=evaluators, n_resamples=50).rows
        }
        for name, evaluators in (("alone", None), ("judged", workspace.data("")))
    }
    assert found["alone"]["corr/gaze_in_space"].reason == "needs corr: missing in the motions"
    rows = found["judged"]
    assert rows["corr/gaze_in_space"].value == rows["corr/gaze_in_space"].reference
    written = json.loads(workspace.data("evaluate", "truth", "benchmark.json").read_text())
    validate(written, json_schema())
    assert written["benchmark_version"] == VERSION
    stage = written["metrics"]
    assert stage["corr/gaze_in_space"]["reason"].startswith("needs 20 judged motions")
    assert rows["corr/head_minus_shuffled"].count == rows["corr/head"].count == sum(1 for _ in truth.rglob("*.npz"))
    assert rows["corr/head_minus_shuffled"].value.value != rows["corr/head"].value.value
    with pytest.raises(InputError, match="should be the data folder of a finished pipeline"):
        compare(truth, workspace.corpus, evaluators=workspace.corpus)


def test_a_model_without_samples_is_named(workspace):
    with pytest.raises(InputError, match="sample/nobody"):
        evaluate.run(workspace, "nobody")
    assert not workspace.data("evaluate", "nobody").exists()


def test_l2_excludes_the_first_take_of_the_same_sound():
    head = np.zeros((3, FRAMES, 3))
    head[1] += 0.1  # norm 0.1 sqrt 3
    head[2] += 0.3
    takes = Samples(25.0, head, np.zeros((3, FRAMES, 2, 3)))
    seen = np.ones(FRAMES, bool)
    scores = {critic: CorrScores(np.ones(3), np.full(3, np.nan)) for critic in CRITIC_PARTS}
    figures = clip_metrics(EvaluationCase("a", takes, True, takes, None, seen), scores, scores)["head"]
    assert figures.l2 == pytest.approx(0.2 * np.sqrt(3))
    assert figures.diversity == pytest.approx((0.1 + 0.3 + 0.2) / 3 * np.sqrt(3))
    alone = Samples(25.0, head[:1], takes.gaze[:1])
    single = clip_metrics(EvaluationCase("b", alone, True, alone, None, seen), scores, scores)["head"]
    assert np.isnan(single.l2)
    table = summarise("head", [figures, single], BOOTSTRAP)
    assert table["l2"].value == pytest.approx(0.2 * np.sqrt(3))
    assert table["diversity_ratio"].value == 1


def emotional_sounds(people: range) -> list[EmotionalSound]:
    """A synthetic take of 8 s of each person in three emotions."""
    found = []
    for number in people:
        style = sample_style(np.random.default_rng(number))
        for emotion in ("angry", "neutral", "sad"):
            said = Annotation(speaking=(Span(0.0, 8.0),), emotion=emotion, intensity=0 if emotion == "neutral" else 3)
            take = sample_take(said, style, 8.0, np.random.default_rng(number), PHYSIOLOGICAL)
            features = head_gaze_features(Samples.of(25.0, [take.motion(25.0, 200)]))
            found.append(EmotionalSound(f"s{number}", emotion, features))
    return found


def test_emotion_is_recognised_from_head_and_gaze_but_not_of_others():
    train, held_out = emotional_sounds(range(24)), emotional_sounds(range(24, 40))
    classifier = fit_classifier(np.concatenate([each.features for each in train]), [each.emotion for each in train])
    own = emotion_recognised(classifier, held_out, BOOTSTRAP)
    others = [
        replace(each, features=other.features)
        for each, other in zip(held_out, np.random.default_rng(0).permutation(np.array(held_out, object)), strict=True)
    ]
    strange = emotion_recognised(classifier, others, BOOTSTRAP)
    assert own.speakers_low > 0.6
    assert strange.low < 1 / 3 < strange.high


def test_emotions_are_learnt_from_real_motion_of_the_train_split(tmp_path):
    toys = toy_workspace(tmp_path)
    corpus, settings = Corpus(toys.corpus), toys.settings("evaluate", evaluate.EvaluateSettings)
    sounds = emotional_sounds(range(2))
    assert critic.train_emotion_classifier(toys) is None, "of toys without emotions"
    assert evaluate._emotion(tmp_path, sounds, settings) == {}
    felt = [replace(clip, emotion=("sad", "neutral")[place % 2]) for place, clip in enumerate(corpus.clips)]
    corpus.write_index(felt)
    trained = critic.train_emotion_classifier(toys)
    assert trained is not None
    trained.save(tmp_path / EMOTION_FILE)
    found = evaluate._emotion(tmp_path, sounds, settings)
    assert found["chance"] == pytest.approx(1 / 3)
    assert 0 <= found["recognised"]["low"] <= found["recognised"]["value"] <= 2 / 3, "angry is not among the trained"
