"""Fine-tuning of a part of wav2vec 2.0, on a small random checkpoint: frozen layers are unchanged, others trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from model_conf import compose
from test_training import NAMES, NORMALISER, translation
from toy import CHANNELS, recordings

from talkingeyes.audio.annotation import Annotation
from talkingeyes.audio.encoder_transformers import TransformersEncoder, TransformersSettings
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Normaliser, Recording
from talkingeyes.corpus.store import Corpus
from talkingeyes.models.waveform_encoder import WaveformEncoder, WaveformEncoderSettings
from talkingeyes.training import checkpoint
from talkingeyes.training.conditioning import ConditioningPaths, ConditioningProvider
from talkingeyes.training.gaze_tokenizer import GazeTokenizerSettings, GazeTokenizerTask
from talkingeyes.training.loop import train
from talkingeyes.training.motion_generators import load_generator, network_config, required_inputs
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings

FRAMES = 100


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A random wav2vec 2.0 with two layers of width 32."""
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    config = transformers.Wav2Vec2Config(
        hidden_size=32, num_hidden_layers=2, num_attention_heads=2, intermediate_size=48, conv_dim=(16,) * 7,
        num_conv_pos_embeddings=16, num_conv_pos_embedding_groups=2, layerdrop=0.0,
    )  # fmt: skip
    place = tmp_path_factory.mktemp("wav2vec2")
    transformers.Wav2Vec2Model(config).save_pretrained(place)
    return place


def waveform_encoder(folder: Path, **changes: Any) -> WaveformEncoderSettings:
    settings = {"checkpoint": str(folder), "trainable_layers": 1, "window_s": 10.0, "overlap_s": 0.5}
    return WaveformEncoderSettings.model_validate(settings | changes)


def sounds(root: Path, clips: list[Recording]) -> ConditioningPaths:
    """A corpus with the sound of every clip."""
    corpus, rng = Corpus(root), np.random.default_rng(0)
    for each in clips:
        corpus.write_sound(each.clip.sound, 0.1 * rng.standard_normal(len(each) * 640), Annotation())
    return ConditioningPaths(corpus, root)


def test_features_equal_those_of_frozen_encoder(folder: Path) -> None:
    frozen = TransformersEncoder(
        TransformersSettings(kind="wav2vec2", checkpoint=str(folder), layer=2, window_s=10.0, overlap_s=0.5)
    )
    sound = np.random.default_rng(1).standard_normal(50 * 640).astype(np.float32)
    encoder = WaveformEncoder(waveform_encoder(folder), None).eval()
    with torch.no_grad():
        ours = encoder(torch.from_numpy(sound)[None], 50)[0].numpy()
        parts = WaveformEncoder(waveform_encoder(folder, window_s=1.0, overlap_s=0.2), None).eval()(
            torch.from_numpy(sound)[None], 50
        )
    np.testing.assert_allclose(ours, frozen(sound, 25.0), atol=1e-4)
    assert parts.shape == (1, 50, 32)
    assert torch.isfinite(parts).all()


def test_frozen_part_is_unchanged_and_the_rest_trains(folder: Path, tmp_path: Path) -> None:
    clips = recordings(4, seed=1, frames=FRAMES), recordings(1, seed=2, frames=FRAMES)
    conditioning_paths = sounds(tmp_path, [*clips[0], *clips[1]])
    node = translation("vae", steps=12, batch=4, validate_every=4).model_dump(mode="json")
    node["speech"] |= {"channels": [], "waveform_encoder": waveform_encoder(folder).model_dump()}
    settings = MotionTaskSettings.model_validate(node | {"validation_clips": 1})
    task = MotionTask(settings, 0, *clips, NORMALISER, None, conditioning_paths)
    before = {name: each.clone() for name, each in task.module.state_dict().items()}
    history = train(task, settings.loop, "wave")
    assert history[-1]["loss/total"] < history[0]["loss/total"]
    moved = {name for name, each in task.module.state_dict().items() if not torch.equal(each, before[name])}
    prefix = "waveform_encoder.network."
    of_network = {name.removeprefix(prefix) for name in before if name.startswith(prefix)}
    learnt = {name.removeprefix(prefix) for name in moved if name.startswith(prefix)}
    assert learnt
    assert all(name.startswith("encoder.layers.1.") for name in learnt)
    # Biases of the keys cancel in the softmax, so their gradient is only rounding error.
    expected = {name for name in of_network if name.startswith("encoder.layers.1.") and "k_proj.bias" not in name}
    assert expected <= learnt

    checkpoint.save(tmp_path, task.module.state_dict(), network_config(settings, NAMES, None, task.module))
    away = folder.rename(folder.with_name("away"))
    try:
        again = load_generator(tmp_path)
    finally:
        away.rename(folder)
    assert required_inputs(again) == {"sound"}
    one = clips[1][0]
    told = ConditioningProvider({"sound"}, [], conditioning_paths).clip_inputs(one.clip, FRAMES)
    direct = task.module.generate(torch.from_numpy(one.speech), [5], None, told)
    np.testing.assert_allclose(again.generate(one.speech, [5], 25.0, told).gaze, direct.gaze.numpy(), atol=1e-5)
    with pytest.raises(InputError, match=r"^speech.waveform_encoder: .*got none$"):
        again.generate(one.speech, [5], 25.0)


@pytest.fixture()
def experiment() -> dict[str, Any]:
    """The sections of experiment=wav2vec2_finetuning."""
    return compose(["experiment=wav2vec2_finetuning"])


@pytest.mark.long
@pytest.mark.parametrize("name", ["talkingeyes", "talkingeyes_literal", "talkingeyes_events"])
def test_the_experiment_fine_tunes_every_model(
    experiment: dict[str, Any], folder: Path, tmp_path: Path, name: str
) -> None:
    """The models of conf/, their codebooks included; only the checkpoint and the number of steps are replaced."""
    frames = 210  # more than the windows of 200
    clips = recordings(4, seed=1, frames=frames), recordings(1, seed=2, frames=frames)
    node = experiment["model"][f"{name}_wav2vec2"]
    assert node["speech"]["waveform_encoder"]["trainable_layers"] == 4
    node["speech"]["waveform_encoder"] = waveform_encoder(folder).model_dump()
    node["loop"] |= {"steps": 3, "validate_every": 3}
    settings = MotionTaskSettings.model_validate(node | {"validation_clips": 1})
    codebook = None
    if settings.tokenizer is not None:
        tokenizer = experiment["pretrain"][settings.tokenizer]
        tokenizer["loop"] |= {"steps": 6, "validate_every": 6}
        pretraining = GazeTokenizerTask(GazeTokenizerSettings.model_validate(tokenizer), *clips)
        train(pretraining, pretraining.settings.loop, "codes")
        codebook = pretraining.module.freeze()
    channels = ("energy_dbfs", "f0_octaves", "voicing", "0", "1", "2")
    normaliser = Normaliser(channels, np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))
    task = MotionTask(settings, 0, *clips, normaliser, codebook, sounds(tmp_path, [*clips[0], *clips[1]]))
    before = {key: each.clone() for key, each in task.module.state_dict().items()}
    train(task, settings.loop, name)
    moved = {key for key, each in task.module.state_dict().items() if not torch.equal(each, before[key])}
    learnt = {key for key in moved if "waveform_encoder.network." in key}
    assert learnt
    assert all("encoder.layers.1." in key for key in learnt)
    assert any(key.startswith("gaze.") for key in moved)
    sound = task.conditioning_provider.clip_inputs(clips[1][0].clip, frames)
    heard, silent = (
        task.module.generate(torch.from_numpy(clips[1][0].speech), [5], None, replace(sound, sound=wave)).head
        for wave in (sound.sound, torch.zeros_like(sound.sound))
    )
    assert torch.isfinite(heard).all()
    assert not torch.equal(heard, silent)


def test_windows_carry_their_own_sound(tmp_path: Path) -> None:
    (one,) = recordings(1, seed=1, frames=FRAMES)
    conditioning_paths = sounds(tmp_path, [one])
    clip_inputs = conditioning_paths.corpus.speech(one.clip)
    found = ConditioningProvider({"sound"}, [], conditioning_paths).window(replace(one.clip), slice(20, 60), False)[
        "sound"
    ]
    np.testing.assert_array_equal(found, clip_inputs[20 * 640 : 60 * 640])


def test_wrong_settings_are_one_line_errors(folder: Path) -> None:
    with pytest.raises(InputError, match=r"^speech.waveform_encoder.trainable_layers: should be at most 2, got 3$"):
        WaveformEncoder(waveform_encoder(folder, trainable_layers=3), None)
    with pytest.raises(
        InputError, match=r"^speech.waveform_encoder.checkpoint: should be a local folder or a reachable hub"
    ):
        WaveformEncoder(waveform_encoder(folder / "nothing"), None)
