"""All training code places its tensors on the device of training, tested with a simulated GPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fake_gpu import fake_gpu
from model_conf import model_section
from test_contract import CHANNELS, MODELS, codebook, toy_settings
from test_critic import contrast, toy
from test_face_models import BASIS, GENERATORS, data, faces, model_settings, prior_settings, tokenizer_for, tokenizers
from test_posegan import HEADS, pgface_task
from test_posegan import task as pose_task
from test_training import NORMALISER, translation
from test_waveform_encoder import folder, sounds, waveform_encoder
from toy import recordings
from toy_training import toy_training

from pipelines import critic, pretrain
from pipelines import train as train_stage
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.orchestration.config import CONFIG_DIR
from talkingeyes.training import checkpoint
from talkingeyes.training.execution import ExecutionContext
from talkingeyes.training.face_task import FaceTask
from talkingeyes.training.face_tokenizer import FaceTokenizerTask
from talkingeyes.training.gaze_tokenizer import GazeTokenizerSettings, GazeTokenizerTask
from talkingeyes.training.loop import LoopSettings, TrainingTask, train
from talkingeyes.training.motion_generators import load_generator, network_config
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings

__all__ = ["folder", "tokenizers"]  # fixtures
SHORT = {"steps": 2, "validate_every": 2, "batch": 4}
MACHINE = {"device": "cuda", "precision": "bfloat16"}
GAZE_PRIORS = [path.stem for path in sorted((CONFIG_DIR / "pretrain").glob("gaze*.yaml"))]


def learn(task: TrainingTask, loop: LoopSettings | None) -> list[dict[str, float]]:
    """Train for two steps with validation, with the settings of `machine=gpu`."""
    short = LoopSettings.model_validate((loop.model_dump() if loop else {}) | SHORT)
    return train(task, short, "on a card", context=ExecutionContext.of(MACHINE))


def shortened(raw: dict[str, Any]) -> dict[str, Any]:
    whole_clips = raw["windows"]["frames"] is None
    return raw | {"loop": raw["loop"] | SHORT | ({"batch": 1} if whole_clips else {})}


class TestPretence:
    """What the simulated GPU rejects and accepts."""

    def test_tensors_on_different_devices_are_rejected(self) -> None:
        with fake_gpu():
            here, there = torch.zeros(3), torch.zeros(3, device="cuda")
            for mixed in (lambda: here + there, lambda: torch.cat([there, here]), lambda: here[there.long()]):
                with pytest.raises(RuntimeError, match="same device"):
                    mixed()
            with pytest.raises(RuntimeError, match="same device"):
                torch.from_numpy(np.zeros(3)) * there
            with pytest.raises(TypeError, match="numpy"):
                there.numpy()
            with pytest.raises(RuntimeError, match="generator"):
                torch.rand(3, device="cuda", generator=torch.Generator())


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_models_of_head_and_gaze(name: str, tmp_path: Path) -> None:
    raw = model_section(name)
    less = {"init_from": None, "validation_clips": 1, "temperatures": raw["temperatures"][:1]}
    settings, names = toy_settings(shortened(raw) | less)
    normaliser = Normaliser(tuple(names), np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))
    book = codebook(settings.tokenizer)
    clips = recordings(8, seed=1), recordings(2, seed=2, frames=64)
    task = MotionTask(settings, 0, *clips, normaliser, book)
    with fake_gpu():
        history = learn(task, settings.loop)
        task.fit_equaliser()
        task.choose_temperature()
        checkpoint.save(tmp_path, task.module.state_dict(), network_config(settings, names, book, task.module), history)
    speech = recordings(1, seed=9, frames=64)[0].speech
    assert np.isfinite(load_generator(tmp_path).generate(speech, [5], 25.0).gaze).all()


def test_encoder_trained_jointly(folder: Path, tmp_path: Path) -> None:
    clips = recordings(4, seed=1, frames=100), recordings(1, seed=2, frames=100)
    node = translation("vae", **SHORT).model_dump(mode="json")
    node["speech"] |= {"channels": [], "waveform_encoder": waveform_encoder(folder).model_dump()}
    settings = MotionTaskSettings.model_validate(node)
    task = MotionTask(settings, 0, *clips, NORMALISER, None, sounds(tmp_path, [*clips[0], *clips[1]]))
    with fake_gpu():
        learn(task, settings.loop)


@pytest.mark.long
@pytest.mark.parametrize("name", GAZE_PRIORS)
def test_codebooks_of_gaze(name: str) -> None:
    settings = GazeTokenizerSettings.model_validate(shortened(model_section(name, "pretrain")))
    task = GazeTokenizerTask(settings, recordings(12, seed=1), recordings(3, seed=2))
    with fake_gpu():
        learn(task, settings.loop)


@pytest.mark.parametrize("kind", ["vq", "vae"])
def test_autoencoders_of_the_face(kind: str) -> None:
    settings = prior_settings(kind)
    task = FaceTokenizerTask(settings, faces(12, seed=1), faces(3, seed=2), BASIS)
    with fake_gpu():
        learn(task, settings.loop)
        task.fit_latent_statistics()


@pytest.mark.long
@pytest.mark.parametrize("name", GENERATORS)
def test_models_of_the_face(name: str, tokenizers: Any) -> None:
    settings = model_settings(name)
    task = FaceTask(settings, 0, data(), tokenizer_for(name, tokenizers))
    with fake_gpu():
        learn(task, settings.loop)


@pytest.mark.parametrize("name", HEADS)
def test_personal_heads(name: str) -> None:
    task = pose_task(name)
    with fake_gpu():
        if task.settings.loop:
            learn(task, task.settings.loop)


def test_pgface() -> None:
    task = pgface_task()
    with fake_gpu():
        learn(task, task.settings.loop)


def test_the_critic() -> None:
    task = contrast(toy(coupled=True))
    with fake_gpu():
        learn(task, task.settings.loop)


@pytest.mark.long
def test_stages(tmp_path: Path) -> None:
    workspace = toy_training(tmp_path, **SHORT)
    workspace.params["machine"].update(MACHINE)  # type: ignore[index]
    with fake_gpu():
        pretrain.run(workspace, "codes")
        train_stage.run(workspace, "joint")
        critic.run(workspace)
    assert (tmp_path / "data/train/joint/model.safetensors").exists()
    assert (tmp_path / "data/critic/report.json").exists()
