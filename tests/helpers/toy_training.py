"""A workspace of toy recordings in which `pretrain`, `train` and `critic` run in seconds."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from test_training import tokenizer, translation
from toy import CHANNELS, recordings
from toy_workspace import _section

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Workspace, checksums

SPLITS = {"train": 9, "val": 1, "test": 2, "unseen": 2}
# Runs the stage as its command does, without logging to MLflow.
RUN = "import sys; from pathlib import Path; from talkingeyes.orchestration.run import Workspace; "
RUN += "from pipelines import {stage}; "
RUN += "{stage}.run(Workspace.open(Path.cwd()), *sys.argv[1:])"


def toy_training(root: Path, dropout: float = 0.0, **changes: Any) -> Workspace:
    """Settings of codebook `codes`, models `mean` and `joint` and the critic; `changes` apply to all training loops."""
    critic: Any = _section(Path(__file__).resolve().parents[2], "critic")
    joint = translation("categorical", **changes).model_dump(mode="json") | {
        "tokenizer": "codes",
        "validation_clips": 1,
    }
    baseline = {"kind": "mean", "parts": ["head", "gaze"], "tokenizer": None, "neighbours": 1}
    params = {
        "corpus": "data/synthesize",
        "machine": {"jobs": 1, "backend": "processes", "ray_address": None, "device": "cpu", "precision": "float32"},
        "pretrain": {"codes": tokenizer(4, **changes).model_dump(mode="json")},
        "train": {"seed": 0},
        "model": {"mean": baseline, "joint": joint},
        "critic": critic
        | {
            "channels": ["0", "1"],
            "window_s": 4.0,
            "loop": critic["loop"] | changes,
        },
    }
    root.mkdir(parents=True, exist_ok=True)
    (root / "params.yaml").write_text(yaml.safe_dump(_with_dropout(params, dropout)))
    _write_data(root / "data")
    return Workspace.open(root)


def _with_dropout(node: Any, dropout: float) -> Any:
    if not isinstance(node, dict):
        return node
    return {key: dropout if key.endswith("dropout") else _with_dropout(value, dropout) for key, value in node.items()}


def command(stage: str, *names: str) -> list[str]:
    """A subprocess that runs a stage in its working directory."""
    return [sys.executable, "-c", RUN.format(stage=stage), *names]


def _write_data(data: Path) -> None:
    corpus, embed, fit = Corpus(data / "synthesize"), data / "embed", data / "fit"
    corpus.root.mkdir(parents=True)
    clips = []
    for seed, (split, count) in enumerate(SPLITS.items()):
        for index, each in enumerate(recordings(count, seed)):
            clip = replace(each.clip, split=split, speaker=f"{split}-{index % 3}")
            clips.append(clip)
            np.save(make_shard_path(embed / "speech", clip.sound, ".npy"), each.speech)
            Motion.of(25.0, each.head, each.gaze).save(make_shard_path(fit / "motion", clip.id, ".npz"))
    corpus.write_index(clips)
    names = [str(index) for index in range(CHANNELS)]
    content = {"fps": 25.0, "channels": names, "mean": [0.0] * CHANNELS, "std": [1.0] * CHANNELS}
    (embed / "embedding.json").write_text(json.dumps(content))
    (fit / "blinks.json").write_text("{}")
    (fit / "speakers.json").write_text("{}")
    for folder in (embed, fit):
        (folder / CHECKSUMS_FILE).write_text(checksums(folder))
