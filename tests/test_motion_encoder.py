"""The motion encoder: training, loading, and sensitivity of the Frechet distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from toy import recordings

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import eye_in_head, gaze_in_space
from talkingeyes.evaluation.measures.distribution import Gaussian, frechet
from talkingeyes.evaluation.measures.motion_encoder import (
    CHECKPOINT_NAME,
    EncoderSettings,
    MotionEncoder,
    fit_motion_encoder,
)
from talkingeyes.models.motion_autoencoder import MotionAutoencoderSettings, window_features
from talkingeyes.training.checkpoint import save
from talkingeyes.training.loop import LoopSettings

FPS = 25.0
SETTINGS = EncoderSettings(
    window_s=2.56,
    hop_s=1.28,
    network=MotionAutoencoderSettings(step_frames=4, width=64, latent=8, kl_weight=0.3),
    loop=LoopSettings(
        steps=100,
        batch=24,
        learning_rate=0.005,
        schedule="one-cycle",
        weight_decay=0.01,
        clip_norm=1.0,
        validate_every=50,
    ),
)


@pytest.fixture(scope="module")
def learnt():
    """Encoder trained on toy motion, with its history."""
    return fit_motion_encoder(recordings(40, 0), recordings(8, 1), SETTINGS, seed=0)


def test_steps_hold_angles_in_degrees_and_logarithms_of_speed() -> None:
    head = np.zeros((1, 64, 3))
    head[0, :, 1] = np.radians(np.arange(64) * 0.4)  # turns left at 10 degrees per second under still gaze
    gaze = eye_in_head(head, np.zeros((1, 64, 2, 2)))
    steps = window_features(head, gaze, FPS, 4)
    assert steps.shape == (1, 16, 13)
    assert steps[0, :, :2] == pytest.approx(0, abs=1e-9)
    assert steps[0, 3, 2] == pytest.approx(-np.mean([12, 13, 14, 15]) * 0.4)
    assert steps[0, 3, 5] == pytest.approx(np.mean([12, 13, 14, 15]) * 0.4)
    assert np.exp(steps[0, :, 7:]) - 1 == pytest.approx(np.tile([0, 10, 10, 0, 10, 10], (16, 1)), abs=1e-5)


def test_encoder_generalises_to_unseen_speakers(learnt) -> None:
    explained = [row["explained_variance"] for row in learnt.history]
    assert explained[-1] > max(0.15, explained[0])


def test_the_same_seed_gives_the_same_weights() -> None:
    few = SETTINGS.loop.model_copy(update={"steps": 3})
    weights = []
    for _ in range(2):
        found = fit_motion_encoder(
            recordings(6, 0), recordings(2, 1), SETTINGS.model_copy(update={"loop": few}), seed=0
        )
        weights.append(found.encoder.network.state_dict())
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_its_files_give_the_same_features(learnt, tmp_path: Path) -> None:
    encoder = learnt.encoder
    (tmp_path / CHECKPOINT_NAME).mkdir()
    save(tmp_path / CHECKPOINT_NAME, encoder.network.state_dict(), encoder.config)
    one = recordings(1, 5)[0]
    arguments = (one.head[None].astype(float), one.gaze[None].astype(float), FPS)
    assert (MotionEncoder.load(tmp_path)(*arguments) == encoder(*arguments)).all()


def test_windows_are_those_of_each_sample_in_turn(learnt) -> None:
    encoder, (one, two) = learnt.encoder, recordings(2, 5)
    head, gaze = (np.stack([getattr(each, name) for each in (one, two)]).astype(float) for name in ("head", "gaze"))
    features = encoder(head, gaze, FPS)
    count = 1 + (len(one) - 64) // 32
    assert features.shape == (2 * count, 10)
    assert features[count:] == pytest.approx(encoder(head[1:], gaze[1:], FPS), abs=1e-5)
    assert encoder(head[:, :40], gaze[:, :40], FPS).shape == (0, 10)


def test_higher_rates_are_subsampled_and_others_are_errors(learnt) -> None:
    encoder, one = learnt.encoder, recordings(1, 5)[0]
    head, gaze = one.head[None].astype(float), one.gaze[None].astype(float)
    twice = encoder(np.repeat(head, 2, axis=1), np.repeat(gaze, 2, axis=1), 50.0)
    assert twice == pytest.approx(encoder(head, gaze, FPS))
    for fps in (30.0, 12.5):
        with pytest.raises(InputError, match=f"multiple of 25 fps, got {fps:g}"):
            encoder(head, gaze, fps)


def test_frozen_smoothed_and_jittered_motion_is_farther_than_split_half(learnt) -> None:
    encoder = learnt.encoder
    kernel = np.ones(25) / 25

    def smooth(angles: np.ndarray) -> np.ndarray:
        return np.apply_along_axis(lambda path: np.convolve(path, kernel, mode="same"), 0, angles)

    def features(change) -> list[np.ndarray]:
        changed = (change(each.head.astype(float), each.gaze.astype(float)) for each in recordings(40, 7))
        return [encoder(head[None], gaze[None], FPS) for head, gaze in changed]

    def gaussian(clips: list[np.ndarray]) -> Gaussian:
        windows = np.concatenate(clips)
        return Gaussian(windows.mean(axis=0), np.cov(windows.T, bias=True))

    rng = np.random.default_rng(0)
    truth = features(lambda head, gaze: (head, gaze))
    orders = [rng.permutation(len(truth)) for _ in range(20)]
    halves = [[gaussian([truth[index] for index in half]) for half in np.array_split(order, 2)] for order in orders]
    floor = np.mean([frechet(one, other) for one, other in halves])
    changes = {
        "frozen": lambda head, gaze: (head * 0 + head[0], gaze * 0 + gaze[0]),
        "smooth": lambda head, gaze: (head, eye_in_head(head, smooth(gaze_in_space(head, gaze)))),
        "trembling": lambda head, gaze: (head, gaze + rng.normal(0, 0.015, gaze.shape)),
    }
    for name, change in changes.items():
        assert frechet(gaussian(features(change)), gaussian(truth)) > 2 * floor, name


def test_clip_shorter_than_window_is_an_error() -> None:
    with pytest.raises(InputError, match="window_s: should fit into a train clip"):
        fit_motion_encoder(recordings(2, 0, frames=40), recordings(2, 1), SETTINGS, seed=0)
