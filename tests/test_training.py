"""Training loop, windows, free-running statistics, codebooks, joint models, baselines: learning and reproducibility."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import welch
from test_gaze_models import GAZE, TRANSFORMER, VAE
from torch import Tensor, nn
from toy import CHANNELS, recordings

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Normaliser, Recording
from talkingeyes.models.baselines import BaselineSettings, MotionBank
from talkingeyes.models.speech_to_motion import MotionBatch
from talkingeyes.training import checkpoint
from talkingeyes.training.baseline_checkpoint import save_baseline
from talkingeyes.training.conditioning import WITHOUT_CONDITIONING, motion_array
from talkingeyes.training.free_running import free_running_statistics
from talkingeyes.training.gaze_tokenizer import GazeTokenizerSettings, GazeTokenizerTask
from talkingeyes.training.loop import LoopSettings, train
from talkingeyes.training.motion_generators import load_generator, network_config
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings
from talkingeyes.training.windows import WindowDataset, WindowSettings, motion_batch, motion_statistics

LOOP = {
    "steps": 60,
    "batch": 8,
    "learning_rate": 3e-3,
    "schedule": "one-cycle",
    "weight_decay": 0.0,
    "clip_norm": 1.0,
    "validate_every": 30,
}
NAMES = tuple(str(index) for index in range(CHANNELS))
NORMALISER = Normaliser(NAMES, np.zeros(CHANNELS, np.float32), np.ones(CHANNELS, np.float32))


class Line:
    """A toy task that fits a line; with `spoil` its score decreases from step 20."""

    def __init__(self, spoil: bool = False) -> None:
        torch.manual_seed(0)
        self.module: nn.Module = nn.Linear(1, 1)
        self.spoil, self.seen = spoil, 0
        self.rng = np.random.default_rng(0)

    def losses(self, step: int) -> dict[str, Tensor]:
        x = torch.linspace(-1, 1, 16)[:, None]
        error = (self.module(x) - 3 * x - 1).square().mean()
        self.seen = step
        return {"total": error}

    def validate(self) -> dict[str, float]:
        return {"validation_score": -float(self.seen) if self.spoil else float(self.seen)}


def loop(**changes: Any) -> LoopSettings:
    return LoopSettings(**(LOOP | changes))


def test_the_loop_fits_a_line_and_keeps_its_history() -> None:
    task = Line()
    history = train(task, loop(steps=300, learning_rate=0.1, validate_every=100), "line")
    assert [row["step"] for row in history] == [100, 200, 300]
    assert history[-1]["loss/total"] < 1e-2 < history[0]["loss/total"]


def test_the_loop_keeps_the_weights_of_the_best_score() -> None:
    early, spoiled = Line(), Line(spoil=True)
    settings = loop(steps=40, validate_every=20, schedule="constant", learning_rate=0.01)
    train(early, settings.model_copy(update={"steps": 20}), "line")
    train(spoiled, settings, "line")
    assert torch.equal(early.module.weight, spoiled.module.weight)


def windows(clips: list[Recording], frames: int | None) -> WindowDataset[Recording, MotionBatch]:
    return WindowDataset(
        clips, WindowSettings(frames=frames, mirror=False), 0, partial(motion_batch, WITHOUT_CONDITIONING)
    )


def test_windows_are_cut_anywhere_and_short_clips_are_refused() -> None:
    clips = recordings(4, seed=3)
    drawn = windows(clips, 50).sample_batch(64, 1)
    assert drawn.head.shape == (64, 50, 3)
    starts = {int(np.flatnonzero((c.head == window[0].numpy()).all(1))[0]) for window in drawn.head for c in clips
              if (c.head == window[0].numpy()).all(1).any()}  # fmt: skip
    assert len(starts) > 20
    with pytest.raises(InputError, match="at most 210"):
        windows(clips, 500)


def test_whole_clips_come_once_an_epoch_and_alone() -> None:
    clips = [replace(each, head=each.head + index) for index, each in enumerate(recordings(5, seed=3))]
    dataset = windows(clips, None)
    epochs = [[dataset.sample_batch(1, 5 * epoch + step).head[0] for step in range(1, 6)] for epoch in range(2)]
    orders = [[round(float(each.mean())) for each in epoch] for epoch in epochs]
    assert all(sorted(order) == [0, 1, 2, 3, 4] for order in orders)
    assert orders[0] != orders[1]
    assert [len(each) for each in epochs[0]] == [len(clips[index]) for index in orders[0]]
    with pytest.raises(InputError, match=r"loop.batch: should be 1 for whole clips \(windows.frames=null\), got 8"):
        dataset.sample_batch(8, 1)


def test_statistics_use_one_scale_and_ignore_constant_numbers() -> None:
    frames = np.random.default_rng(0).normal(2, 0.5, (10_000, 3))
    frames[:, 2] = 0
    found = motion_statistics(frames)
    assert found.scale == pytest.approx(0.5, rel=0.05)
    np.testing.assert_allclose(found.mean, [2, 2, 0], atol=0.05)


def test_free_running_statistics_detect_frozen_and_jittered_motion() -> None:
    clips = recordings(6, seed=4)
    head, gaze = [c.head for c in clips], [c.gaze for c in clips]
    truth = free_running_statistics(head, gaze, 25.0)
    rng = np.random.default_rng(0)
    frozen = free_running_statistics(head, [np.zeros_like(g) for g in gaze], 25.0)
    trembling = free_running_statistics(head, [g + rng.normal(0, 0.01, g.shape).astype(np.float32) for g in gaze], 25.0)
    assert truth.distance(truth) == 0
    assert frozen.distance(truth) > 2
    assert trembling.distance(truth) > 1
    assert truth.still_fraction_in_space > 0.9
    assert trembling.still_fraction_in_space < 0.2


def tokenizer(patch: int, **changes: Any) -> GazeTokenizerSettings:
    return GazeTokenizerSettings.model_validate(
        {
            "kind": "gaze",
            "seed": 0,
            "network": {
                "signal": "gaze_in_space" if patch > 1 else "eye_in_head",
                "frames_per_code": patch,
                "stay_tolerance_deg": 1.0 if patch > 1 else None,
                "norm": "standardised_mean",
                "standardised": True,
                "quantiser": {
                    "kind": "codebook",
                    "codes": 32,
                    "width": 8,
                    "commitment": 0.25,
                    "decay": 0.9,
                    "restart_below": 0.1,
                },
                "encoder": TRANSFORMER,
                "decoder": TRANSFORMER,
            },
            "windows": {"frames": 100, "mirror": True},
            "loop": LOOP | changes,
        }
    )


@pytest.mark.long
@pytest.mark.parametrize("patch", [1, 4])
def test_codebook_trains_uses_codes_and_is_reproducible(patch: int) -> None:
    train_clips, val = recordings(12, seed=1), recordings(3, seed=2)
    first = GazeTokenizerTask(tokenizer(patch), train_clips, val)
    first.module.eval()
    before = first.code_usage(val).error_deg
    history = train(first, tokenizer(patch).loop, "tokenizer")
    second = GazeTokenizerTask(tokenizer(patch), train_clips, val)
    train(second, tokenizer(patch).loop, "tokenizer")
    code_usage = first.code_usage(train_clips)
    assert code_usage.error_deg < 0.75 * before
    assert code_usage.figures()["codes_used_fraction"] > 0.8
    assert history[-1]["loss/reconstruction"] < history[0]["loss/reconstruction"]
    assert all(torch.equal(a, b) for a, b in zip(
        first.module.state_dict().values(), second.module.state_dict().values(), strict=True))  # fmt: skip
    if patch > 1:
        assert 0.4 < code_usage.stay_fraction < 0.95


def translation(kind: str, **changes: Any) -> MotionTaskSettings:
    names = {
        "categorical": ["codes"],
        "point_process": ["time", "location"],
        "regression": ["reconstruction", "velocity", "regularity"],
    }
    loss_terms = names.get(kind, ["reconstruction", "velocity", "kl"])
    return MotionTaskSettings.model_validate(
        {
            "kind": "speech_to_motion",
            "parts": ["head", "gaze"],
            "tokenizer": None,
            "speech": {"channels": ["2", "0", "1"], "width": 12, "layers": 1, "dropout": 0.0, "channel_dropout": 0.0},
            "head": {"kind": "vae", "norm": "standardised_mean", "standardised": True, **VAE},
            "gaze": {"kind": kind, **GAZE[kind]},
            "conditions": [],
            "init_from": None,
            "reconstructed_heads": 0.5,
            "weights": {"head_reconstruction": 1.0, "head_velocity": 1.0, "head_kl": 0.1}
            | {f"gaze_{each}": 1.0 for each in loss_terms},
            "temperatures": [1.0, 0.5],
            "windows": {"frames": 80, "mirror": True},
            "loop": LOOP | changes,
            "validation_clips": 2,
        }
    )


def codebook(kind: str) -> Any:
    if kind in ("vae", "point_process"):
        return None
    settings = tokenizer(4 if kind == "categorical" else 1, steps=40)
    task = GazeTokenizerTask(settings, recordings(12, seed=1), recordings(2, seed=2))
    train(task, settings.loop, "tokenizer")
    return task.module.freeze()


@pytest.mark.parametrize("kind", GAZE)
def test_joint_model_trains_and_samples_the_same_after_loading(kind: str, tmp_path: Any) -> None:
    settings, book = translation(kind), codebook(kind)
    task = MotionTask(settings, 0, recordings(12, seed=1), recordings(3, seed=2), NORMALISER, book)
    history = train(task, settings.loop, "joint")
    assert history[-1]["loss/total"] < history[0]["loss/total"]
    assert {"free_running/eye_speed", "free_running/still_fraction_in_space", "validation_score"} <= history[-1].keys()
    chosen = task.choose_temperature()
    assert float(task.module.temperature) in settings.temperatures
    assert len(chosen) == len(settings.temperatures)
    checkpoint.save(tmp_path, task.module.state_dict(), network_config(settings, NAMES, book), history)
    speech = recordings(1, seed=9)[0].speech
    again = load_generator(tmp_path).generate(speech, [5], 25.0)
    direct = task.module.generate(torch.from_numpy(speech), [5])
    np.testing.assert_allclose(again.gaze, direct.gaze.numpy(), atol=1e-6)
    np.testing.assert_allclose(again.head, direct.head.numpy(), atol=1e-6)


def test_equaliser_of_event_head_is_fitted_last() -> None:
    strokes = GAZE["point_process"]["process"] | {"absolute_components": 0}
    head = {"kind": "point_process", "temperature": 1.0, "equaliser_frames": 65, "process": strokes}
    asked = translation("point_process", steps=2, validate_every=2).model_dump()
    weights = {f"{part}_{term}": 1.0 for part in ("head", "gaze") for term in ("time", "location")}
    settings = MotionTaskSettings.model_validate(asked | {"head": head, "weights": weights})
    clips = recordings(12, seed=1)
    task = MotionTask(settings, 0, clips, recordings(3, seed=2), NORMALISER, None)
    train(task, settings.loop, "joint")

    def apart() -> float:
        drawn = [
            task.module.generate_head(torch.from_numpy(clip.speech), [50 + i])[0].numpy()
            for i, clip in enumerate(clips)
        ]
        powers = [
            np.mean([welch(each, nperseg=64, axis=0)[1].mean(axis=1) for each in motions], axis=0)
            for motions in (drawn, [clip.head for clip in clips])
        ]
        return float(np.abs(np.log(powers[0] / powers[1]))[1:20].mean())

    before = apart()
    task.fit_equaliser()
    assert (
        apart() < before - 1
    )  # nats; toy heads are pure sines, which a filter with gains up to 3 cannot match completely
    taps = task.module.head.equaliser.taps.clone()
    task.fit_equaliser()  # from the same samples, not from equalised ones
    torch.testing.assert_close(task.module.head.equaliser.taps, taps)


def baseline(kind: str, tmp_path: Any) -> Any:
    clips = recordings(8, seed=1)
    settings = BaselineSettings.model_validate(
        {"kind": kind, "parts": ["head", "gaze"], "tokenizer": None, "neighbours": 3}
    )
    motions = [motion_array(each.head, each.gaze) for each in clips]
    bank = MotionBank.of([each.speech for each in clips], motions, NORMALISER.mean, NORMALISER.std)
    save_baseline(tmp_path, settings, bank)
    return clips, load_generator(tmp_path)


def test_a_baseline_of_an_old_configuration_is_a_one_line_error(tmp_path: Any) -> None:
    baseline("mean", tmp_path)
    saved = checkpoint.load(tmp_path)
    checkpoint.save(tmp_path, saved.tensors, {"model": saved.config["model"] | {"prior": 1}})
    with pytest.raises(InputError, match=r"\(model\.prior: .*, got 1\); `make repro`") as error:
        load_generator(tmp_path)
    assert "\n" not in str(error.value)


def test_mean_never_moves(tmp_path: Any) -> None:
    clips, generator = baseline("mean", tmp_path)
    out = generator.generate(clips[0].speech, [1, 2], 25.0)
    assert np.ptp(out.gaze, axis=(0, 1)).max() == 0
    np.testing.assert_allclose(out.head[0, 0], np.concatenate([c.head for c in clips]).mean(0), atol=1e-6)


@pytest.mark.parametrize("kind", ["random", "similar"])
def test_sampled_motion_is_a_piece_of_one_clip(kind: str, tmp_path: Any) -> None:
    clips, generator = baseline(kind, tmp_path)
    out = generator.generate(clips[2].speech[:150], list(range(12)), 25.0)
    sources = set()
    for head, gaze in zip(out.head, out.gaze, strict=True):
        (index, start), = [(i, int(j)) for i, c in enumerate(clips)
                           for j in np.flatnonzero(np.isclose(c.head, head[0], atol=1e-7).all(1))]  # fmt: skip
        np.testing.assert_allclose(clips[index].head[start : start + 150], head, atol=1e-7)
        np.testing.assert_allclose(clips[index].gaze[start : start + 150], gaze, atol=1e-7)
        sources.add(index)
    assert len(sources) <= 3 if kind == "similar" else len(sources) > 3
    if kind == "similar":
        assert 2 in sources, "the clip of the same sound is the nearest"


def test_a_longer_sound_holds_the_last_pose_instead_of_looping(tmp_path: Any) -> None:
    _, generator = baseline("random", tmp_path)
    out = generator.generate(np.zeros((300, CHANNELS), np.float32), [1], 25.0)
    assert np.ptp(out.head[0, 209:], axis=0).max() == 0


def test_missing_or_damaged_model_is_one_line_error(tmp_path: Any) -> None:
    with pytest.raises(InputError, match="make repro"):
        load_generator(tmp_path / "none")
    baseline("mean", tmp_path)
    (tmp_path / "model.safetensors").write_bytes(b"broken")
    with pytest.raises(InputError, match="not a trained model"):
        load_generator(tmp_path)


def test_distance_uses_logarithms_so_that_double_and_half_count_the_same() -> None:
    from talkingeyes.training.free_running import FreeRunningStatistics

    truth = FreeRunningStatistics(10.0, 100.0, 0.9, 8.0)
    double, half = FreeRunningStatistics(20.0, 100.0, 0.9, 8.0), FreeRunningStatistics(5.0, 100.0, 0.9, 8.0)
    assert double.distance(truth) == pytest.approx(half.distance(truth)) == pytest.approx(math.log(2))
