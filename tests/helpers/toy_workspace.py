"""An artificial workspace: noise as the input of `critic`, `evaluate` and `report`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import yaml
from toy import recordings

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.orchestration.run import Workspace
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.conditioning import motion_array

FPS, FRAMES, CHANNELS = 25.0, 75, 5
NAMES = ["one", "two", "energy_dbfs", "f0_octaves", "voicing"]
SPEAKERS = {"a": "train", "b": "train", "c": "train", "d": "train", "e": "test", "f": "unseen"}


def toy_workspace(root: Path, jobs: int = 1) -> Workspace:
    """Six speakers with four sounds; sound 0 of a test or unseen speaker has three takes. Models: mean, random."""
    repository = Path(__file__).resolve().parents[2]
    sections = {stage: _section(repository, stage) for stage in ("critic", "evaluate")}
    sections["report"] = {"film_s": 0.4}
    root.mkdir(parents=True, exist_ok=True)
    machine = {"jobs": jobs, "device": "cpu", "precision": "float32"}
    (root / "params.yaml").write_text(yaml.safe_dump({"corpus": "data/synthesize", "machine": machine, **sections}))
    clips = _clips()
    corpus = Corpus(root / "data" / "synthesize")
    corpus.root.mkdir(parents=True)
    corpus.write_index(clips)
    rng = np.random.default_rng(0)
    embed = root / "data" / "embed"
    for clip in clips:
        motion = _motion(rng)
        motion.save(make_shard_path(corpus.root / "truth", clip.id, ".npz"))
        jittered = Motion.of(FPS, motion.head + rng.normal(0, 1e-3, (FRAMES, 3)), motion.gaze)
        jittered.save(make_shard_path(root / "data" / "fit" / "motion", clip.id, ".npz"))
        if clip.take == 0:
            speech = rng.normal(size=(FRAMES, CHANNELS)).astype(np.float32)
            noise = rng.uniform(-0.1, 0.1, FRAMES * 640).astype(np.float32)
            corpus.write_sound(clip.sound, noise, Annotation())
            np.save(make_shard_path(embed / "speech", clip.sound, ".npy"), speech)
            if clip.split != "train":
                _samples(rng, still=True).save(_sample_path(root, "mean", clip))
                _samples(rng, still=False).save(_sample_path(root, "random", clip))
    statistics = {"fps": FPS, "channels": NAMES, "mean": [0.0] * CHANNELS, "std": [1.0] * CHANNELS}
    (embed / "embedding.json").write_text(json.dumps(statistics))
    return Workspace.open(root)


def train_random(made: Workspace) -> None:
    """Write a trained baseline `random` for the speech features of the workspace."""
    clips = recordings(4, seed=2, frames=300)
    names = json.loads(made.data("embed", "embedding.json").read_text())["channels"]
    speech = [each.speech[:, : len(names)] for each in clips]
    motions = [motion_array(each.head, each.gaze) for each in clips]
    mean, std = np.zeros(len(names), np.float32), np.ones(len(names), np.float32)
    settings = BaselineSettings(kind="random", parts=("head", "gaze"), tokenizer=None, neighbours=1)
    with made.output("train", "random") as folder:
        save_baseline(folder, settings, MotionBank.of(speech, motions, mean, std))


def _section(repository: Path, stage: str) -> object:
    folder = repository / "conf" / stage
    tiny = yaml.safe_load((folder / "tiny.yaml").read_text())
    tiny.pop("defaults")
    return _merged(yaml.safe_load((folder / "default.yaml").read_text()), tiny)


def _merged(one: dict, other: dict) -> dict:
    nested = {k: _merged(one[k], v) if isinstance(v, dict) else v for k, v in other.items()}
    return {**one, **nested}


def _clips() -> list[Clip]:
    found = []
    for speaker, split in SPEAKERS.items():
        for number in range(4):
            sound = f"{speaker}{number}"
            for take in range(3 if number == 0 and split != "train" else 1):
                name = f"{sound}-t{take}"
                found.append(
                    Clip(name, sound, take, speaker, split, FRAMES / FPS, FPS, "", 0, "en", "", "toy", "CC0", "")
                )
    return found


def _motion(rng: np.random.Generator) -> Motion:
    head = np.cumsum(rng.normal(0, 0.01, (FRAMES, 3)), axis=0)
    gaze = np.repeat(np.cumsum(rng.normal(0, 0.02, (FRAMES, 1, 3)) * [1, 1, 0], axis=0), 2, axis=1)
    return Motion.of(FPS, head, gaze)


def _samples(rng: np.random.Generator, still: bool) -> Samples:
    motions = [_motion(rng) for _ in range(4)]
    scale = 0.0 if still else 1.0
    return Samples(FPS, scale * np.stack([m.head for m in motions]), scale * np.stack([m.gaze for m in motions]))


def _sample_path(root: Path, model: str, clip: Clip) -> Path:
    return make_shard_path(root / "data" / "sample" / model, clip.id, ".npz")
