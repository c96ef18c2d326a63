"""An untrained streaming model in the format of the stage `train`: conf/model/talkingeyes_live.yaml with all its parts.

`CODES` samples codes of frames instead, as conf/model/talkingeyes.yaml does, but without lookahead.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from model_conf import model_section

from talkingeyes.animation.model_file import LIVE_FACE_FOLDER
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face.style import StyleVocabulary
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.speech_to_face import SpeechToFace
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.orchestration.config import CONFIG_DIR
from talkingeyes.physiology.face import FACE_SHAPES
from talkingeyes.training.checkpoint import save
from talkingeyes.training.face_task import FaceTaskSettings
from talkingeyes.training.motion_generators import network_config
from talkingeyes.training.motion_task import MotionTaskSettings


def content(*place: str) -> Any:
    """A file of conf/."""
    return yaml.safe_load(CONFIG_DIR.joinpath(*place).read_text())


LIVE_GAZE = model_section("talkingeyes_live")["gaze"]
CODES = {
    "tokenizer": "gaze_patches",
    "gaze": model_section("talkingeyes")["gaze"] | {"condition_lookback": 12, "condition_lookahead": 0},
}


def codebook() -> GazeVQVAE:
    """Untrained codebook of four frames of gaze in space."""
    settings = GazeVQVAESettings.model_validate(model_section("gaze_patches", "pretrain")["network"])
    network = GazeVQVAE(settings)
    network.normalise_by(torch.zeros_like(network.mean), 0.2)
    network.quantiser.train()
    network.quantiser(torch.randn(1, 64, settings.quantiser.width))
    return network.freeze()


def embedding_settings() -> EmbedSettings:
    """The default section `embed` with the encoder that needs no weights."""
    node = {**content("embed", "default.yaml"), "encoder": content("embed", "encoder", "logmel.yaml")}
    node.pop("defaults")
    return EmbedSettings.model_validate(node)


def write_live_model(folder: Path, speakers: Sequence[str] = (), **changes: Any) -> Path:
    """Write a model with changed top-level settings and these training speakers."""
    torch.manual_seed(3)
    settings = MotionTaskSettings.model_validate(model_section("talkingeyes_live") | changes)
    embedding = embedding_settings()
    channels = make_encoder(embedding).channels
    tokenizer = codebook() if settings.tokenizer else None
    network = SpeechToMotion(settings, channels, tokenizer, speakers)
    network.speech.standardise_by(torch.full((len(channels),), -20.0), torch.full((len(channels),), 10.0))
    network.head.normal.set(torch.tensor([0.05, 0.0, 0.0]), 0.1)
    network.gaze.normalise_by(torch.zeros(6), 0.2)
    folder.mkdir(parents=True)
    save(folder, network.state_dict(), network_config(settings, channels, tokenizer, network))
    (folder / "embedding.json").write_text(
        json.dumps({"fps": 25.0, "channels": channels, "settings": embedding.model_dump(mode="json")})
    )
    law = {"mean": 3.1, "sd": 0.3}
    (folder / "blinks.json").write_text(json.dumps({"speakers": {"log_normal": law, "count": 5, "without_blinks": 0}}))
    (folder / "speakers.json").write_text("{}")
    write_live_face(folder.parent / LIVE_FACE_FOLDER)
    return folder


def write_live_face(folder: Path, embedding: EmbedSettings | None = None, **changes: Any) -> Path:
    """Write an untrained face for streams (conf/model/face_live.yaml, narrower) with changed top-level settings."""
    torch.manual_seed(4)
    section = model_section("face_live")
    section["speech"]["width"] = 24
    settings, embedding = FaceTaskSettings.model_validate(section | changes), embedding or embedding_settings()
    channels, basis = make_encoder(embedding).channels, FaceBasis("anny", FACE_SHAPES)
    network = SpeechToFace(settings, channels, StyleVocabulary(("s1", "s2")), basis.numbers, None)
    network.speech.standardise_by(torch.full((len(channels),), -10.0), torch.full((len(channels),), 10.0))
    network.face.normalise_by(torch.full((basis.numbers,), 0.2), torch.full((basis.numbers,), 0.2))
    network.set_range(torch.zeros(basis.numbers), torch.full((basis.numbers,), 0.8))
    folder.mkdir(parents=True, exist_ok=True)
    config = {"model": settings.model_dump(mode="json"), "channels": channels, "basis": basis.to_dict()}
    save(folder, network.state_dict(), {**config, "speakers": ["s1", "s2"], "tokenizer": None})
    (folder / "embedding.json").write_text(
        json.dumps({"fps": 25.0, "channels": channels, "settings": embedding.model_dump(mode="json")})
    )
    return folder
