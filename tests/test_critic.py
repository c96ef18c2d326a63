"""The critic learns the coupling of sound and motion, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from model_conf import compose

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.measures.critic import (
    ChannelSelection,
    ContrastiveTask,
    CriticCorrelation,
    CriticSettings,
    auc,
    new_critic,
    split_speakers,
)
from talkingeyes.evaluation.measures.motion_encoder import EncoderSettings
from talkingeyes.models.contrastive_critic import CRITIC_PARTS, Critic, CriticNetworkSettings, part_angles
from talkingeyes.training.loop import LoopSettings, train

FPS = 25.0
ENCODER = EncoderSettings.model_validate(compose()["critic"]["encoder"])  # unused here
SETTINGS = CriticSettings(
    seed=0,
    channels=["loud"],
    window_s=8.0,
    hop_s=0.8,
    held_out=0.25,
    windows_per_speaker=6,
    time_shifted_negatives=2,
    min_shift_s=1.0,
    scale_augmentation=1.25,
    temperature=0.1,
    network=CriticNetworkSettings(step_frames=4, width=16, layers=2, kernel=5, features=8, dropout=0.1),
    loop=LoopSettings(
        steps=60,
        batch=24,
        learning_rate=0.01,
        schedule="one-cycle",
        weight_decay=0.01,
        clip_norm=1.0,
        validate_every=20,
    ),
    encoder=ENCODER,
    bootstrap=BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0),
)
HEARING = ChannelSelection(np.arange(6), np.zeros(6, np.float32), np.ones(6, np.float32))


def toy(coupled: bool, speakers: int = 12, sounds: int = 8) -> list[Recording]:
    """Noise whose loudness determines head speed if `coupled`; every speaker has a voice and a posture."""
    rng = np.random.default_rng(1)
    found = []
    for speaker in range(speakers):
        voice, posture = rng.normal(0, 1, 6), rng.normal(0, 0.2, 3)
        for sound in range(sounds):
            loud = np.repeat(rng.random(9) < 0.5, 25)[:210].astype(float)
            speech = voice + rng.normal(0, 0.3, (210, 6))
            speech[:, 0] += loud
            drive = loud if coupled else np.repeat(rng.random(9) < 0.5, 25)[:210]
            head = posture * (1 + 0.1 * speaker) + np.cumsum(rng.normal(0, 0.02, (210, 3)) * drive[:, None], axis=0)
            name = f"{speaker}-{sound}"
            clip = Clip(name, name, 0, str(speaker), "train", 8.4, FPS, "", 0, "en", "", "", "", "")
            gaze = np.zeros((210, 2, 3), np.float32)
            found.append(Recording(clip, speech.astype(np.float32), head.astype(np.float32), gaze, np.ones(210, bool)))
    return found


def contrast(recordings: list[Recording]) -> ContrastiveTask:
    torch.manual_seed(0)
    critic = new_critic("head", recordings, HEARING, SETTINGS)
    return ContrastiveTask("head", critic, recordings, split_speakers(recordings, SETTINGS), FPS, SETTINGS)


def learnt(recordings: list[Recording]) -> tuple[ContrastiveTask, list[dict[str, float]]]:
    task = contrast(recordings)
    return task, train(task, SETTINGS.loop, "critic")


def test_learns_simulated_coupling_on_unseen_speakers() -> None:
    assert max(row["validation_score"] for row in learnt(toy(coupled=True))[1]) > 0.85


def test_no_coupling_gives_chance_level_despite_voice_and_posture() -> None:
    assert abs(learnt(toy(coupled=False))[1][-1]["validation_score"] - 0.5) < 0.15


def test_training_is_repeatable() -> None:
    recordings = toy(coupled=True, speakers=4, sounds=4)
    first, second = learnt(recordings)[0].critic.state_dict(), learnt(recordings)[0].critic.state_dict()
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_training_and_held_out_speakers_are_disjoint() -> None:
    recordings = toy(coupled=True)
    division = split_speakers(recordings, SETTINGS)
    train_speakers = {recordings[index].clip.speaker for index in division.train}
    held_out = {recordings[index].clip.speaker for index in division.held_out}
    assert not train_speakers & held_out
    assert len(held_out) == 3
    with pytest.raises(InputError, match="two speakers, got 1"):
        split_speakers([each for each in recordings if each.clip.speaker == "0"], SETTINGS)


def test_auc_by_hand() -> None:
    assert auc(np.array([2.0, 3.0]), np.array([1.0, 2.0, 0.0])) == pytest.approx(5.5 / 6)
    assert auc(np.array([1.0]), np.array([1.0, 1.0])) == 0.5


@pytest.mark.parametrize("part", CRITIC_PARTS)
def test_corr_is_cosine_invariant_to_posture_and_batching(part: str) -> None:
    rng = np.random.default_rng(0)
    network = SETTINGS.network
    count = 3 if part == "head" else 2
    critic = Critic(network, torch.arange(6), torch.zeros(6), torch.ones(6), torch.ones(2), count)
    corr = CriticCorrelation(part, critic, frames=200, hop=20)
    speech = rng.normal(size=(240, 6)).astype(np.float32)
    head, gaze = rng.normal(0, 0.1, (4, 240, 3)), rng.normal(0, 0.1, (4, 240, 2, 3))
    values = corr(speech, head, gaze)
    assert values.shape == (4,)
    assert (np.abs(values) <= 1 + 1e-6).all()
    assert corr(speech, head[2:3], gaze[2:3]) == pytest.approx(values[2:3], abs=1e-6)
    if part != "gaze_in_space":
        assert corr(speech, head + 0.2, gaze - 0.1) == pytest.approx(values, abs=1e-5)
    assert corr(speech[:150], head[:, :150], gaze[:, :150]).shape == (4,)


def test_gaze_in_space_is_invariant_to_counter_rotation() -> None:
    turn = np.zeros((1, 20, 3))
    turn[..., 1] = np.linspace(0, 0.3, 20)
    gaze = -np.repeat(turn[:, :, None], 2, axis=2)
    assert np.ptp(part_angles("gaze_in_space", turn, gaze), axis=1).max() < 1e-9
    assert np.ptp(part_angles("eyes", turn, gaze), axis=1).max() == pytest.approx(0.3)


def test_missing_channel_is_named() -> None:
    embedding = {"channels": ["a", "b", "c"], "mean": [0.0, 1.0, 2.0], "std": [1.0, 1.0, 0.0]}
    assert ChannelSelection.of(embedding, ["c", "a"]).mean.tolist() == [2.0, 0.0]
    with pytest.raises(InputError, match="got loudness"):
        ChannelSelection.of(embedding, ["a", "loudness"])


def test_time_shifts_are_the_negatives_with_one_sound_per_speaker() -> None:
    lonely = toy(coupled=True, speakers=12, sounds=1)
    task, history = learnt(lonely)
    assert task.time_shifts_only
    assert not learnt(toy(coupled=True, speakers=4, sounds=4))[0].time_shifts_only
    assert max(row["validation_score"] for row in history) > 0.7  # the simulated coupling, by time shifts alone
    with pytest.raises(InputError, match=r"critic.time_shifted_negatives"):
        silent = SETTINGS.model_copy(update={"time_shifted_negatives": 0})
        ContrastiveTask("head", task.critic, lonely, split_speakers(lonely, silent), FPS, silent)


def test_short_window_is_shifted_by_half() -> None:
    """Clips of a second; without a limit on the shift, `integers` would get the empty interval from 25 to 0."""
    short = [
        Recording(each.clip, each.speech[:25], each.head[:25], each.gaze[:25], each.valid[:25])
        for each in toy(coupled=True, speakers=3, sounds=2)
    ]
    task = ContrastiveTask(
        "head", new_critic("head", short, HEARING, SETTINGS), short, split_speakers(short, SETTINGS), FPS, SETTINGS
    )
    assert np.isfinite(task.losses(0)["total"].item())
    with torch.no_grad():
        assert 0 <= task.validate()["validation_score"] <= 1
