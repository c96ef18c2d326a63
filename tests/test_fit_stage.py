"""The stage `fit` on a small corpus of scenes, with and without truth."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fitting_scene import FPS, scene
from model_conf import compose

from pipelines import fit as stage
from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.fitting.clip import FitSettings
from talkingeyes.fitting.motion_style import load_speakers
from talkingeyes.orchestration.run import Workspace

GOOD, BAD = 3, 1


def make_corpus(root: Path, truth: bool = True, bad: int = BAD, good: int = GOOD) -> Corpus:
    """Clips of scenes of two speakers, the second of val; the last `bad` clips have no visible face."""
    corpus, clips = Corpus(root), []
    root.mkdir(parents=True)
    for index in range(good + bad):
        known = scene(index)
        seen = known.observation
        if index >= good:
            seen = replace(seen, landmarks=seen.landmarks * np.nan)
        name = f"s{index}"
        corpus.write_sound(name, np.zeros(16_000, np.float32), Annotation())
        corpus.write_clip(name, seen, known.motion if truth else None, known.events if truth else None)
        speaker, split = f"p{index % 2}", ("train", "val")[index % 2]
        clips.append(Clip(name, name, 0, speaker, split, 8.8, FPS, "", 0, "en", "", "", "", ""))
    corpus.write_index(clips)
    return corpus


def workspace(root: Path, repository: Path, adam_clips: int = 1) -> Workspace:
    """A workspace with the default section `fit`, except for few clips with Adam that stop early."""
    section = compose()["fit"]
    section["method_comparison"]["adam_clips"] = adam_clips
    section["lightgazefit"]["adam"]["steps"] = 30
    return Workspace(root, {"corpus": "data/synthesize", "machine": {"jobs": 1}, "fit": section})


def test_fit_writes_motion_and_reports(tmp_path: Path, repository: Path):
    make_corpus(tmp_path / "data/synthesize")
    report = stage.run(workspace(tmp_path, repository))
    folder = tmp_path / "data/fit"
    for index in range(GOOD):
        motion = Motion.load(shard_path(folder / "motion", f"s{index}", ".npz"))
        assert len(motion) == 220
        assert motion.fps == FPS
    assert not shard_path(folder / "motion", "s3", ".npz").exists()
    rows = list(csv.reader((folder / "rejected.csv").read_text().splitlines()))
    assert rows[0] == ["clip", "reason"]
    assert [row[0] for row in rows[1:]] == ["s3"]
    table = {row["method"]: row for row in json.loads((folder / "table8.json").read_text())["rows"]}
    assert {"ground_truth", "per_frame", "lightgazefit", "lightgazefit_adam"} <= set(table)
    assert table["lightgazefit"]["error_px"] < table["per_frame"]["error_px"]
    assert table["ground_truth"]["velocity_ratio"] == 1.0
    blinks = json.loads((folder / "blinks.json").read_text())
    assert (blinks["clips"]["count"], blinks["speakers"]["count"]) == (2, 1), "of the train split only"
    speakers = load_speakers(folder / "speakers.json")
    assert set(speakers) == {"p0"}
    assert all(manner.head_sd_rad[1] > 0 and manner.saccades_per_min > 0 for manner in speakers.values())
    assert report.metrics["blink_recall"] > 0.9
    assert report.metrics["lightgazefit/error_px"] == table["lightgazefit"]["error_px"]


def test_same_bytes_whatever_the_number_of_jobs(tmp_path: Path, repository: Path):
    make_corpus(tmp_path / "data/synthesize")
    one = workspace(tmp_path, repository, adam_clips=0)
    contents = []
    for jobs in (1, 2):
        stage.run(replace(one, params={**one.params, "machine": {"jobs": jobs}}))
        folder = tmp_path / "data/fit"
        contents.append({path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()})
    assert contents[0] == contents[1]


def test_tracked_video_without_truth_gets_no_truth_columns(tmp_path: Path, repository: Path):
    make_corpus(tmp_path / "data/synthesize", truth=False, bad=0, good=2)
    report = stage.run(workspace(tmp_path, repository))
    table = json.loads((tmp_path / "data/fit/table8.json").read_text())["rows"]
    assert "ground_truth" not in {row["method"] for row in table}
    assert all("error_px" not in row and row["velocity_px_s"] > 0 for row in table)
    assert "head_error_deg" not in report.metrics


def test_nothing_to_fit_is_one_line_error_without_output(tmp_path: Path, repository: Path):
    make_corpus(tmp_path / "data/synthesize", good=0, bad=2)
    with pytest.raises(InputError, match="all 2 clips were rejected"):
        stage.run(workspace(tmp_path, repository))
    assert not (tmp_path / "data/fit").exists()


@pytest.mark.parametrize("variant", ["default", "adam", "paper", "tiny", "video"])
def test_each_variant_of_the_section_is_valid(variant: str):
    settings = FitSettings.model_validate(compose([f"fit={variant}"])["fit"])
    assert settings.lightgazefit.weights == (1e-4, 1e-2)
