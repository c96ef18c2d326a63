"""The stage `embed` on a small artificial corpus."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model_conf import compose

from pipelines import embed
from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.orchestration.run import Workspace

SECTION = {
    "encoder": {"kind": "logmel", "bands": 20, "window_s": 0.05, "windows_per_frame": 1},
    "prosody": {
        "f0_min_hz": 60.0,
        "f0_max_hz": 450.0,
        "yin_threshold": 0.25,
        "energy_window_s": 0.05,
        "energy_floor_dbfs": -80.0,
    },
    "level_dbfs": -20.0,
}


def clip(sound: str, split: str, take: int = 0, fps: float = 25.0) -> Clip:
    return Clip(
        f"{sound}-t{take}", sound, take, "one", split, 1.0, fps, "neutral", 0, "en", "", "noise", "CC0-1.0", sound
    )


def workspace(root: Path, clips: list[Clip], jobs: int = 1) -> Workspace:
    corpus = Corpus(root / "data" / "synthesize")
    corpus.root.mkdir(parents=True)
    for index, sound in enumerate(sorted({clip.sound for clip in clips})):
        rng = np.random.default_rng(index)
        samples = rng.standard_normal(16_000) * np.hanning(16_000) * 0.1
        corpus.write_sound(sound, samples.astype(np.float32), Annotation())
    corpus.write_index(clips)
    params: dict[str, Any] = {"corpus": "data/synthesize", "embed": SECTION, "machine": {"jobs": jobs}}
    return Workspace(root, params)


CLIPS = [clip("a", "train"), clip("a", "train", take=1), clip("b", "train"), clip("c", "test")]


def test_every_sound_is_embedded_once_and_statistics_come_from_train_alone(tmp_path: Path) -> None:
    place = workspace(tmp_path, CLIPS)
    report = embed.run(place)
    assert report.metrics["sounds"] == 3
    assert len(list(place.data("embed", "speech").rglob("*.npy"))) == 3
    features = {name: np.load(shard_path(place.data("embed", "speech"), name, ".npy")) for name in "abc"}
    speech = Corpus(place.corpus).speech(CLIPS[0])
    np.testing.assert_array_equal(features["a"], make_encoder(EmbedSettings.model_validate(SECTION))(speech, 25.0))
    content = json.loads(place.data("embed", "embedding.json").read_text())
    train = np.concatenate([features["a"], features["b"]])
    np.testing.assert_allclose(content["mean"], train.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(content["std"], np.maximum(train.std(axis=0), embed.MIN_STD), rtol=1e-3, atol=1e-4)
    assert content["fps"] == 25
    assert len(content["channels"]) == features["a"].shape[1] == 28
    assert EmbedSettings.model_validate(content["settings"]) == EmbedSettings.model_validate(SECTION)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_output_is_independent_of_jobs(tmp_path: Path) -> None:
    for jobs in (1, 2):
        embed.run(workspace(tmp_path / str(jobs), CLIPS, jobs))
    one, two = (tmp_path / str(jobs) / "data" / "embed" for jobs in (1, 2))
    files = [path.relative_to(one) for path in one.rglob("*") if path.is_file()]
    assert len(files) == 5  # three sounds, embedding.json, SHA256SUMS
    assert all((one / file).read_bytes() == (two / file).read_bytes() for file in files)


@pytest.mark.parametrize(
    ("clips", "words"),
    [
        ([clip("a", "train"), clip("b", "train", fps=30.0)], "single frame rate"),
        ([clip("a", "test")], "split train"),
    ],
)
def test_failing_corpus_leaves_no_output(tmp_path: Path, clips: list[Clip], words: str) -> None:
    place = workspace(tmp_path, clips)
    with pytest.raises(InputError, match=words):
        embed.run(place)
    assert not place.data("embed").exists()


@pytest.mark.parametrize("name", ["default", "logmel", "wav2vec2", "hubert"])
def test_each_variant_of_the_section_is_complete(name: str) -> None:
    section = compose([f"embed={name}"])["embed"]
    kind = validate_section("embed", EmbedSettings, section).encoder.kind
    assert kind == ("moonshine" if name == "default" else name)
