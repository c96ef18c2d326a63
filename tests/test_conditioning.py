"""Conditioning besides speech: the speaker and the emotion; and the initial pose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_training import NAMES, NORMALISER, translation
from toy import CHANNELS, recordings

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.recordings import Recording
from talkingeyes.models.condition.conditioner import (
    CONDITIONERS,
    NO_CONDITIONING,
    ConditioningInputs,
    ConditioningSpec,
)
from talkingeyes.training import checkpoint
from talkingeyes.training.conditioning import (
    ConditioningProvider,
    speaker_index,
)
from talkingeyes.training.loop import train
from talkingeyes.training.motion_generators import load_generator, network_config, training_speakers
from talkingeyes.training.motion_task import MotionTask, MotionTaskSettings

SPEAKER = {"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.5, "gaze": 2.0}}
LONG = {"steps": 100, "learning_rate": 1e-2, "validate_every": 100}
KNOWN = ConditioningSpec(NAMES, ("a", "b"))


def conditioner() -> Any:
    """The conditioner on the speaker."""
    torch.manual_seed(0)
    return CONDITIONERS.build(CONDITIONERS.parse(SPEAKER), 12, KNOWN).eval()


def conditioned(rows: int) -> ConditioningInputs:
    """Conditioning inputs; the last window has the null condition."""
    return ConditioningInputs(torch.tensor([*range(rows - 1), -1]))


def test_output_depends_on_conditioning() -> None:
    made = conditioner()
    both = made(conditioned(3), 3)
    for found in (both.head, both.gaze):
        assert found.shape[0] == 3
        assert found.shape[1] == 1
        assert found.shape[2] == 12
        assert torch.isfinite(found).all()
        assert (found[0] - found[1]).abs().max() > 1e-3
    assert set(made.required_inputs) == {"speaker"}


def test_null_condition_is_the_same_alone_and_in_a_batch() -> None:
    made = conditioner()
    nothing, beside = made(NO_CONDITIONING, 2), made(conditioned(3), 3)
    torch.testing.assert_close(beside.head[2:].mean(1), nothing.head[:1].mean(1))
    torch.testing.assert_close(beside.gaze[2:].mean(1), nothing.gaze[:1].mean(1))


def test_hidden_speaker_is_unconditional() -> None:
    made = conditioner().train()
    made.condition_dropout = 1.0
    assert torch.equal(made(conditioned(3), 3).head, made(NO_CONDITIONING, 3).head)


def people(count: int, seed: int) -> list[Recording]:
    """Two speakers; `b` holds the head turned aside."""
    found = []
    for index, each in enumerate(recordings(count, seed)):
        aside_rad, who = (0.0, "a") if index % 2 else (0.2, "b")
        turned = (each.head + np.array([0, aside_rad, 0])).astype(np.float32)
        found.append(replace(each, clip=replace(each.clip, speaker=who), head=turned))
    return found


def task_of(condition: dict[str, Any], **changes: Any) -> MotionTask:
    node = translation("vae", **changes).model_dump(mode="json") | {"conditions": [condition]}
    node["weights"]["head_kl"] = 3.0  # with a weak weight the codes carry all information and the condition none
    settings = MotionTaskSettings.model_validate(node)
    return MotionTask(settings, 0, people(12, seed=1), people(3, seed=2), NORMALISER, None, None)


def aside_rad(task: MotionTask, one: ConditioningInputs) -> float:
    """Mean head pose of several samples."""
    speech = torch.from_numpy(recordings(1, seed=9)[0].speech)
    return float(task.module.generate(speech, list(range(6)), 1.0, one).head[..., 1].mean())


@pytest.mark.long
def test_training_speaker_moves_like_that_speaker(tmp_path: Path) -> None:
    task = task_of(
        {"kind": "speaker", "condition_dropout": 0.1, "embedding_scale": {"head": 1.0, "gaze": 1.0}},
        **LONG | {"steps": 200, "validate_every": 200},
    )
    train(task, task.settings.loop, "speaker")
    straight, turned = (ConditioningInputs(speaker=torch.tensor([index])) for index in (0, 1))
    assert aside_rad(task, turned) > aside_rad(task, straight) + 0.02
    checkpoint.save(tmp_path, task.module.state_dict(), network_config(task.settings, NAMES, None, task.module))
    assert training_speakers(load_generator(tmp_path)) == ("a", "b")


def test_unseen_speaker_is_a_random_training_speaker_for_each_sound() -> None:
    known = [f"s{number}" for number in range(9)]
    drawn = [speaker_index(known, "stranger", f"sound {number}") for number in range(200)]
    assert set(drawn) == set(range(9))
    assert drawn == [speaker_index(known, "stranger", f"sound {number}") for number in range(200)]
    assert [speaker_index(known, name, "sound 1") for name in known] == list(range(9))
    clip = replace(people(1, seed=4)[0].clip, speaker="stranger", sound="sound 7")
    conditioned = ConditioningProvider({"speaker"}, known, None).clip_inputs(clip, 50)
    assert conditioned.speaker is not None
    assert conditioned.speaker.tolist() == [drawn[7]]


def test_mirrored_window_has_mirrored_condition() -> None:
    clip, conditioning_provider = people(1, seed=4)[0].clip, ConditioningProvider({"speaker"}, ["a", "b"], None)
    symmetric, turned = (
        int(conditioning_provider.window(clip, slice(0, 50), mirror)["speaker"]) for mirror in (False, True)
    )
    assert (symmetric, turned) == (1, 3)
    made = conditioner().train()
    found = made(ConditioningInputs(torch.tensor([1, 3, -1])), 3).head[:, 0]
    torch.testing.assert_close(found[0] + found[1], 2 * made.symmetric.weight[1])
    torch.testing.assert_close(found[0] - found[1], 2 * made.antisymmetric.weight[1])
    torch.testing.assert_close(found[2], made.symmetric.weight[2])


def test_embedding_scale_increases_distances_of_speakers_in_sampling() -> None:
    made, who = conditioner(), ConditioningInputs(torch.tensor([0, 1, 3, -1]))
    used, learnt = made.eval()(who, 4), made.train()(who, 4).head[:, 0]
    for size, part in ((1.5, used.head[:, 0]), (2.0, used.gaze[:, 0])):
        torch.testing.assert_close(part[0] - part[1], size * (learnt[0] - learnt[1]))
        torch.testing.assert_close(part[1] - part[2], size * (learnt[1] - learnt[2]))
        torch.testing.assert_close(part[3], learnt[3])
        antisymmetric = made.antisymmetric.weight[:2].mean(0)
        torch.testing.assert_close(part[:2].mean(0) - learnt[:2].mean(0), (size - 1) * antisymmetric)


def test_emotion_is_zero_where_there_is_none_and_grows_with_intensity() -> None:
    made = CONDITIONERS.build(CONDITIONERS.parse({"kind": "emotion"}), 12, KNOWN)
    clip, provider = people(1, seed=4)[0].clip, ConditioningProvider({"emotion"}, [], None)
    kinds = (("", 0), ("neutral", 0), ("sad", 1), ("sad", 3), ("fear", 3))
    told = [provider.clip_inputs(replace(clip, emotion=emotion, intensity=size), 50) for emotion, size in kinds]
    video, neutral, weak, strong, other = (made(each, 1).head for each in told)
    assert not made(NO_CONDITIONING, 3).head.any()
    assert not video.any()
    assert not neutral.any()
    torch.testing.assert_close(weak, 0.4 * strong)
    assert (strong - other).abs().max() > 0.1


def start(changes: dict[str, Any], other: checkpoint.Checkpoint | None = None) -> MotionTask:
    node = translation("vae", steps=6, validate_every=6).model_dump(mode="json")
    node["speech"] |= changes
    settings = MotionTaskSettings.model_validate(node)
    return MotionTask(settings, 3, people(4, seed=1), people(2, seed=2), NORMALISER, None, None, other)


def test_new_speakers_start_as_the_mean_speaker() -> None:
    condition = SPEAKER
    node = translation("vae").model_dump(mode="json") | {"conditions": [condition]}
    settings = MotionTaskSettings.model_validate(node)
    known = task_of(condition).module
    config = {"speakers": list(known.speakers)}
    others = [replace(each, clip=replace(each.clip, speaker="c")) for each in people(4, seed=1)]
    other = checkpoint.Checkpoint(config, known.state_dict())
    new = MotionTask(settings, 3, others, others, NORMALISER, None, None, other).module
    (before,), (after,) = known.conditioners, new.conditioners
    for name in ("symmetric", "antisymmetric"):
        theirs, own = (getattr(each, name).weight for each in (before, after))
        torch.testing.assert_close(own, torch.stack([theirs[:2].mean(0), theirs[2]]))
    same = MotionTask(settings, 3, people(12, seed=1), others, NORMALISER, None, None, other).module
    assert torch.equal(same.conditioners[0].symmetric.weight, before.symmetric.weight)


def test_model_with_sound_starts_as_tokenizer_and_learns_to_use_sound() -> None:
    unconditional = start({"channels": []})
    speech, other = (torch.randn(50, CHANNELS) for _ in range(2))
    train(unconditional, unconditional.settings.loop, "prior")
    assert torch.equal(unconditional.module.generate(speech, [1]).gaze, unconditional.module.generate(other, [1]).gaze)
    prior = checkpoint.Checkpoint({}, unconditional.module.state_dict())
    tied = start({"channels": None}, prior)
    tied.module.eval()
    with torch.no_grad():
        at_first, before = (each.module.generate(speech, [1], 1.0) for each in (tied, unconditional))
    torch.testing.assert_close(at_first.gaze, before.gaze, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(at_first.head, before.head, atol=1e-5, rtol=1e-4)
    train(tied, tied.settings.loop, "tied")
    conditioned = [tied.module.generate(each, [1], 1.0).gaze for each in (speech, other)]
    assert (conditioned[0] - conditioned[1]).abs().max() > 1e-6
    with pytest.raises(InputError, match=r"^init_from: should be a model of the same parts"):
        start({"channels": None, "width": 16}, prior)
