"""A model folder that needs no training: a baseline over toy motions with the log-mel encoder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import soundfile
from toy import recordings

from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.conditioning import motion_array

EMBED = {
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
BLINKS = {"speakers": {"log_normal": {"mean": 3.0, "sd": 0.3}, "count": 9, "without_blinks": 0}}


def toy_model(folder: Path) -> Path:
    """Write the model; it samples from the motions of `toy`."""
    folder.mkdir(parents=True)
    channels = make_encoder(EmbedSettings.model_validate(EMBED)).channels
    clips = recordings(6, seed=1)
    rng = np.random.default_rng(0)
    features = [rng.standard_normal((len(clip.head), len(channels))).astype(np.float32) for clip in clips]
    settings = BaselineSettings.model_validate(
        {"kind": "similar", "parts": ["head", "gaze"], "tokenizer": None, "neighbours": 3}
    )
    mean, std = np.zeros(len(channels), np.float32), np.ones(len(channels), np.float32)
    motions = [motion_array(clip.head, clip.gaze) for clip in clips]
    save_baseline(folder, settings, MotionBank.of(features, motions, mean, std))
    embedding = {"fps": 25.0, "settings": EMBED, "channels": channels, "mean": mean.tolist(), "std": std.tolist()}
    (folder / "embedding.json").write_text(json.dumps(embedding))
    (folder / "blinks.json").write_text(json.dumps(BLINKS))
    (folder / "speakers.json").write_text("{}")
    return folder


def sound_file(path: Path, seconds: float = 1.0, seed: int = 0) -> Path:
    """Noise of varying loudness."""
    times = np.arange(round(seconds * 16_000)) / 16_000
    noise = np.random.default_rng(seed).normal(0, 0.1, len(times)) * (1 + np.sin(2 * np.pi * 3 * times)) / 2
    soundfile.write(path, noise, 16_000)
    return path
