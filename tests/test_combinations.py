"""Every head generator can be combined with every gaze decoder by configuration: trained jointly or in sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from model_conf import MODEL_NAMES, model_section
from test_contract import CHANNELS, batch, codebook
from test_posegan import HEADS, normaliser, task

from talkingeyes.core.errors import InputError
from talkingeyes.models.gaze.generator import GAZE_GENERATORS
from talkingeyes.models.head.generator import HEAD_GENERATORS
from talkingeyes.models.head.pose_generator import POSE_GENERATORS
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.training.checkpoint import load, save
from talkingeyes.training.motion_generators import (
    HeadThenGazeSettings,
    load_generator,
    network_config,
    pose_config,
    save_head_then_gaze,
)
from talkingeyes.training.motion_task import MotionTaskSettings

NAMES = [str(index) for index in range(CHANNELS)]
SPEECH = {"channels": None, "width": 16, "layers": 1, "dropout": 0.0, "channel_dropout": 0.0}


def sections(part: str) -> dict[str, dict[str, Any]]:
    """The first model of conf/ with each kind of the part, by kind."""
    found: dict[str, dict[str, Any]] = {}
    for name in MODEL_NAMES:
        node = model_section(name)
        if node["kind"] == "speech_to_motion":
            found.setdefault(node[part]["kind"], node)
    return found


WITH_HEAD, WITH_GAZE = sections("head"), sections("gaze")


def joint(head: str, gaze: str) -> SpeechToMotion:
    """An untrained model with the head of one model of conf/ and the gaze of another."""
    weights = {
        name: weight
        for part, of in (("head_", WITH_HEAD[head]), ("gaze_", WITH_GAZE[gaze]))
        for name, weight in of["weights"].items()
        if name.startswith(part)
    }
    node = WITH_GAZE[gaze] | {"speech": SPEECH, "head": WITH_HEAD[head]["head"], "weights": weights}
    settings = MotionTaskSettings.model_validate(node)
    torch.manual_seed(0)
    made = SpeechToMotion(settings, NAMES, codebook(settings.tokenizer), ("a", "b"))
    made.head.normal.set(torch.zeros(3), 0.1)
    made.gaze.normalise_by(torch.zeros(6), 0.1)
    return made


def test_every_kind_is_in_conf() -> None:
    assert set(WITH_HEAD) >= set(HEAD_GENERATORS.kinds)
    assert set(WITH_GAZE) >= set(GAZE_GENERATORS.kinds)
    assert {model_section(name)["head"]["kind"] for name in HEADS} == set(POSE_GENERATORS.kinds)


@pytest.mark.parametrize("gaze", WITH_GAZE)
@pytest.mark.parametrize("head", WITH_HEAD)
def test_trained_together(head: str, gaze: str) -> None:
    made = joint(head, gaze).train()
    loss_terms = made.loss_terms(batch())
    assert set(made.settings.weights) <= set(loss_terms)
    loss_terms["total"].backward()
    parts: list[Any] = [made.speech, made.head, made.gaze]
    assert all(any(each.grad is not None and each.grad.abs().sum() > 0 for each in part.parameters()) for part in parts)
    out = made.eval().generate(torch.randn(41, CHANNELS), [1, 2], 1.0)
    assert out.head.shape == (2, 41, 3)
    assert out.gaze.shape == (2, 41, 2, 3)
    assert torch.isfinite(out.head).all()
    assert torch.isfinite(out.gaze).all()
    assert (out.gaze[0] - out.gaze[1]).abs().max() > 1e-5


@pytest.fixture(scope="module")
def gazes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Models with each gaze decoder, in folders in the format of `train`."""
    found = {}
    for gaze in WITH_GAZE:
        made = joint("vae", gaze)
        folder = tmp_path_factory.mktemp(gaze.replace(":", "-"))
        save(folder, made.state_dict(), network_config(made.settings, NAMES, made_codebook(made), made))  # type: ignore[arg-type]
        found[gaze] = folder
    return found


def made_codebook(made: SpeechToMotion) -> Any:
    """The codebook of the gaze decoder, if any."""
    return getattr(made.gaze, "codebook", None)


@pytest.mark.parametrize("head", HEADS)
def test_one_after_the_other(head: str, gazes: dict[str, Path], tmp_path: Path) -> None:
    one = task(head)
    (tmp_path / "head").mkdir()
    save(tmp_path / "head", one.module.state_dict(), pose_config(one.settings, normaliser(), one.module))
    speech = np.random.default_rng(0).standard_normal((24, CHANNELS)).astype(np.float32)
    alone = load_generator(tmp_path / "head").generate(speech, [1, 2], 25.0)
    for gaze, folder in gazes.items():
        node = model_section("head_then_gaze") | {"source_models": [head, gaze]}
        (tmp_path / "both").mkdir(exist_ok=True)
        save_head_then_gaze(
            tmp_path / "both", HeadThenGazeSettings.model_validate(node), load(tmp_path / "head"), load(folder)
        )
        both = load_generator(tmp_path / "both").generate(speech, [1, 2], 25.0)
        np.testing.assert_array_equal(both.head, alone.head)
        assert both.gaze.shape == (2, 24, 2, 3)
        assert np.isfinite(both.gaze).all()
        assert np.abs(both.gaze).max() > 1e-4
    with pytest.raises(InputError, match="speech_to_motion"):
        save_head_then_gaze(
            tmp_path / "both", HeadThenGazeSettings.model_validate(node), load(folder), load(tmp_path / "head")
        )
