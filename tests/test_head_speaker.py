"""Models of the head alone are conditioned on the speaker in `animate`, in `sample` and before a gaze decoder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import call
from model_conf import model_section
from test_posegan import settings
from toy_model import BLINKS, EMBED, sound_file
from toy_workspace import CHANNELS, NAMES, SPEAKERS, toy_workspace

from pipelines import sample
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.models.condition.conditioner import ConditioningInputs
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.models.speech_to_pose import SpeechToPose
from talkingeyes.orchestration.run import Workspace
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.motion_generators import (
    HeadThenGazeSettings,
    TrainedGenerator,
    load_generator,
    network_config,
    pose_config,
    save_head_then_gaze,
    training_speakers,
)
from talkingeyes.training.motion_task import MotionTaskSettings

KNOWN = tuple(name for name, split in SPEAKERS.items() if split == "train")
JOINED = HeadThenGazeSettings(
    kind="head_then_gaze", parts=("head", "gaze"), tokenizer=None, source_models=("posegan", "gaze")
)


def write_posegan(folder: Path, channels: list[str], speakers: tuple[str, ...]) -> Path:
    """An untrained PoseGAN whose speakers start half a radian apart: the first at yaw 0."""
    torch.manual_seed(0)
    folder.mkdir(parents=True)
    network = SpeechToPose(settings("posegan"), channels, speakers)
    network.scale.fill_(0.01)
    network.start_poses[:, :, 1] = 50.0 * torch.arange(len(speakers))[:, None]
    normaliser = Normaliser(tuple(channels), np.zeros(len(channels)), np.ones(len(channels)))
    save(folder, network.state_dict(), pose_config(settings("posegan"), normaliser, network))
    return folder


def write_gaze(folder: Path, channels: list[str], speakers: tuple[str, ...]) -> Path:
    """An untrained model with a gaze decoder, conditioned on the speaker if there is any."""
    torch.manual_seed(1)
    folder.mkdir(parents=True)
    node = model_section("vae")
    condition = {"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.0, "gaze": 1.0}}
    found = MotionTaskSettings.model_validate(node | {"conditions": [condition] if speakers else []})
    network = SpeechToMotion(found, channels, None, speakers)
    save(folder, network.state_dict(), network_config(found, channels, None, network))
    return folder


def joined(root: Path, head: tuple[str, ...], gaze: tuple[str, ...]) -> TrainedGenerator:
    """PoseGAN before the gaze decoder of another model."""
    folders = write_posegan(root / "posegan", NAMES, head), write_gaze(root / "gaze", NAMES, gaze)
    (root / "joined").mkdir()
    save_head_then_gaze(root / "joined", JOINED, *map(load, folders))
    return load_generator(root / "joined")


def first_yaw(head: np.ndarray) -> np.ndarray:
    """Yaw (radians, rounded to 0.01) of the first frame of each motion (S, T, 3): half the number of its speaker."""
    return np.round(head[:, 0, 1], 2)


@pytest.mark.parametrize("gaze", [(), KNOWN])
def test_all_samples_of_a_take_are_of_the_speaker_of_the_take(tmp_path: Path, gaze: tuple[str, ...]) -> None:
    generator = joined(tmp_path, KNOWN, gaze)
    assert training_speakers(generator) == KNOWN
    speech = np.random.default_rng(0).standard_normal((80, CHANNELS)).astype(np.float32)
    for index in range(len(KNOWN)):
        found = generator.generate(speech, list(range(8)), 25.0, ConditioningInputs(torch.tensor([index])))
        np.testing.assert_allclose(first_yaw(found.head), index / 2, atol=0.01)
    unnamed = generator.generate(speech, list(range(8)), 25.0)
    assert len(set(first_yaw(unnamed.head))) == 1, "no speaker is named: the same mixture for all seeds"


def test_the_speakers_of_head_and_gaze_are_the_same(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^source_models: should have the same training speakers, got a, b and b, a"):
        joined(tmp_path, ("a", "b"), ("b", "a"))
    assert not list((tmp_path / "joined").iterdir())


@pytest.mark.parametrize(("person", "yaw"), [("anna", 0.0), ("bert", 0.5)])
def test_animate_obeys_person(
    person: str,
    yaw: float,
    tmp_path: Path,
) -> None:
    assert animate(tmp_path, person) == 0
    found = [first_yaw(Motion.load(each).head[None])[0] for each in sorted((tmp_path / "out").rglob("*.npz"))]
    assert found == pytest.approx([yaw] * 4, abs=0.01)


def test_animate_refuses_a_person_whom_posegan_does_not_know(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(tmp_path, "cleo") == 2
    assert "person: should be one of anna, bert or a number, got cleo" in capsys.readouterr().err


def animate(root: Path, person: str) -> int:
    """Run `talkingeyes animate` with PoseGAN, four samples; returns the exit status."""
    channels = list(make_encoder(EmbedSettings.model_validate(EMBED)).channels)
    model = write_posegan(root / "model", channels, ("anna", "bert"))
    embedding = {"fps": 25.0, "settings": EMBED, "channels": channels}
    for name, content in (("embedding", embedding), ("blinks", BLINKS), ("speakers", {})):
        (model / f"{name}.json").write_text(json.dumps(content))
    sound = sound_file(root / "speech.wav", 2.0)
    asked = ["animate", sound, "-o", root / "out", "--model", model, "--person", person, "--samples", "4"]
    return call(*map(str, asked), "--no-postprocessing", "--no-previews")


def test_the_stage_sample_moves_the_speaker_of_the_clip(tmp_path: Path) -> None:
    made = toy_workspace(tmp_path)
    write_posegan(made.data("train", "posegan"), NAMES, (*KNOWN, "e"))
    workspace = Workspace(made.root, {**made.params, "sample": {"seed": 0, "samples": 4}})
    sample.run(workspace, "posegan")
    for clip in Corpus(workspace.corpus).select("test", "unseen", take=0):
        yaw = first_yaw(Samples.load(shard_path(made.data("sample", "posegan"), clip.id, ".npz")).head)
        assert len(set(yaw)) == 1, "one take, one person"
        if clip.split == "test":
            assert yaw[0] == pytest.approx(len(KNOWN) / 2, abs=0.01)
