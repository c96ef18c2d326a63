"""Model selection on val: `validate` with the gaze benchmark."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import toy_workspace

from pipelines import critic, report, validate
from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.metric_class import LEARNT, class_of
from talkingeyes.evaluation.benchmark.paired import (
    PairedAccumulator,
    motion_behaviours,
    pair_with_truth,
    sample_behaviours,
    sound_statistics,
)
from talkingeyes.evaluation.benchmark.registry import VERSION
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.measures.corr import CRITICS, corr_scores
from talkingeyes.evaluation.report.validation_metrics import SelectionMetric, ValidateSettings
from talkingeyes.orchestration.run import Workspace

BOOTSTRAP = BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0)
FPS, FRAMES, SOUNDS = 25.0, 250, 6


class Deaf:
    """A critic with the same score for every motion."""

    def score_sounds(self, sounds, head, gaze):
        return np.full((len(sounds), len(head)), 0.5)


def moving(rng, jump_rad):
    """A swaying head, and eyes that jump two or three times per second."""
    head = 0.1 * np.sin(np.arange(FRAMES)[:, None] / FPS * [1.0, 2.0, 0.5] + rng.uniform(0, 6, 3))
    places = rng.normal(0, jump_rad, (FRAMES, 3)) * [1, 1, 0]
    held = np.maximum.accumulate(np.where(rng.random(FRAMES) < 2.5 / FPS, np.arange(FRAMES), 0))
    return Motion.of(FPS, head, np.repeat(places[held][:, None], 2, axis=1))


def benchmark(jump_rad):
    """Benchmark of motions with eye jumps of `jump_rad`, where true eyes jump by about ten degrees."""
    rng, critics = np.random.default_rng(0), dict.fromkeys(CRITICS.values(), Deaf())
    paired, speech = PairedAccumulator(), np.zeros((FRAMES, 2))
    for _ in range(SOUNDS):
        true = [moving(rng, 0.15) for _ in range(2)]
        drawn = [moving(rng, jump_rad) for _ in range(2)]
        samples = Samples(FPS, np.stack([each.head for each in drawn]), np.stack([each.gaze for each in drawn]))
        scores = corr_scores(critics, speech, [speech], samples.head, samples.gaze)
        beside = pair_with_truth(sample_behaviours(samples, Annotation()), motion_behaviours(true, Annotation()))
        paired.add(sound_statistics(beside, scores, critics, None, speech, [speech]))
    return paired.table(BOOTSTRAP)


def test_motion_without_saccades_counts_missing_metrics_as_worse():
    alike, frozen = benchmark(0.15), benchmark(0.0)
    assert not alike.missing
    assert alike.learnt.worse < 0.3 * alike.learnt.compared
    assert frozen.learnt.worse > alike.learnt.worse
    missing = sum(class_of(metric.name) == LEARNT for metric in frozen.missing)
    assert 0 < missing < len(frozen.missing)
    assert any(row.metric.name.startswith("saccades/") for row in frozen.rows if row.worse is None)
    learnt = [row.worse for row in frozen.rows if class_of(row.metric.name) == LEARNT]
    assert frozen.learnt.compared == sum(worse is not None for worse in learnt) + missing
    assert frozen.learnt.worse == sum(worse is True for worse in learnt) + missing
    assert json.loads(frozen.json())["sounds"] == SOUNDS
    assert json.loads(PairedAccumulator().table(BOOTSTRAP).json()) == {
        "schema": "talkingeyes.benchmark/3",
        "benchmark_version": VERSION,
        "sounds": 0,
        "metrics": {},
    }


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """Workspace of toy recordings with sounds in val, critics and a baseline."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toy_workspace, "SPEAKERS", {**toy_workspace.SPEAKERS, "g": "val", "h": "val"})
        patch.setattr(toy_workspace, "FRAMES", 300)  # long enough for most metrics
        made = toy_workspace.toy_workspace(tmp_path_factory.mktemp("workspace"))
    critic.run(made)
    toy_workspace.train_random(made)
    section = {"seed": 0, "samples": 2, "bootstrap": BOOTSTRAP.model_dump()}
    return Workspace(made.root, {**made.params, "validate": section})


def test_sweep_metrics_exist_for_any_number_of_processes(workspace):
    path, found = workspace.data("validate", "random"), []
    for jobs in (1, 2):
        validate.run(replace(workspace, params={**workspace.params, "machine": {"jobs": jobs}}), "random")
        found.append([(path / name).read_bytes() for name in ("metrics.json", "benchmark.json")])
    assert found[0] == found[1]
    figures, table = map(json.loads, found[0])
    likelihoods = {name for name in get_args(SelectionMetric) if name.startswith("log_likelihood")}
    assert set(get_args(SelectionMetric)) - likelihoods <= set(figures)
    assert not likelihoods & set(figures), "a baseline has no likelihood"
    assert 0 < figures["metrics_worse"] <= figures["metrics_comparable"]
    assert table["sounds"] == 8
    found = [one["worse"] for name, one in table["metrics"].items() if class_of(name) == LEARNT]
    assert (
        sum(map(bool, found))
        <= figures["metrics_worse"]
        < sum(one["worse"] is not None for one in table["metrics"].values())
    )
    assert table["metrics"]["eye/speed"]["value"] is not None


def test_rows_beside_the_models(workspace):
    """Fitted motion is nearer to the truth than that of other sounds, and only it is tied to its sound."""
    found = {}
    for row in ("fitted", "mismatched"):
        validate.run(workspace, row)
        found[row] = json.loads(workspace.data("validate", row, "metrics.json").read_text())
    assert found["fitted"]["corr"] == found["fitted"]["corr_fitted"]
    assert found["fitted"]["tie"] == found["fitted"]["tie_fitted"]
    assert "diversity" not in found["fitted"]
    assert found["mismatched"]["diversity"] > 0
    assert found["fitted"]["dynamics_distance"] < found["mismatched"]["dynamics_distance"]
    paths = workspace.input_paths("truth")
    settings = workspace.settings("validate", ValidateSettings)
    sounds = validate._sounds(paths, settings)
    takes = [len(sound.takes) for sound in sounds]
    assert len(validate.validate_sounds(paths, settings, sounds)) == sum(number > 1 for number in takes)


def test_rows_without_motion_have_no_figures(workspace, tmp_path):
    """In a corpus with one take of each sound and one sound of each speaker of val, as tracked videos often are."""
    shutil.copytree(workspace.root, tmp_path, dirs_exist_ok=True)
    alone = replace(workspace, root=tmp_path)
    corpus = Corpus(alone.corpus)
    first = {clip.speaker: clip.sound for clip in reversed(corpus.select("val"))}
    corpus.write_index(
        [clip for clip in corpus.clips if clip.take == 0 and clip.sound == first.get(clip.speaker, clip.sound)]
    )
    found = {}
    for row in ("truth", "mismatched", "fitted"):
        validate.run(alone, row)
        figures = json.loads(alone.data("validate", row, "metrics.json").read_text())
        if figures:
            found[row] = figures
    assert list(found) == ["fitted"]
    table = report.validation_table(found)
    cells = [f"{found['fitted'][name]:.3f}" for name in report.VALIDATION_DISTANCES]
    assert f"| {' | '.join(cells)} |  |  |  |" in table


def test_validation_needs_no_file_of_test_or_unseen(workspace, tmp_path):
    shutil.copytree(workspace.root, tmp_path, dirs_exist_ok=True)
    alone = replace(workspace, root=tmp_path)
    held_out = Corpus(alone.corpus).select("test", "unseen")
    names = {name for clip in held_out for name in (clip.id, clip.sound)}
    removed = [path for path in tmp_path.rglob("*") if path.stem in names]
    assert len(removed) >= 3 * len(held_out)
    for path in removed:
        path.unlink()
    for made in (workspace, alone):
        validate.run(made, "random")
    first, second = (made.data("validate", "random", "metrics.json").read_bytes() for made in (workspace, alone))
    assert first == second
