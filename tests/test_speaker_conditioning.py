"""Speaker of an animation: the requested person or a random one by the seed, the same in all samples."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from live_model import write_live_model
from test_training import NAMES, translation
from toy import CHANNELS
from toy_model import EMBED, sound_file

from talkingeyes.animation.animation import Animation
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.fitting.motion_style import MotionStyle
from talkingeyes.models.speech_to_motion import SpeechToMotion
from talkingeyes.physiology.blinks import PAPER, PHYSIOLOGICAL, blink_rate_quantile
from talkingeyes.training.motion_generators import NetworkGenerator
from talkingeyes.training.motion_task import MotionTaskSettings
from talkingeyes.workflows.animate import AnimationOptions, run_dialogue

PERSONS = ("anna", "bert", "cleo")
SPEECH = np.random.default_rng(0).standard_normal((1500, CHANNELS)).astype(np.float32)


def animator(conditions: list[dict[str, Any]]) -> Animator:
    """A network whose only dependence on the speaker is the mean head pose."""
    torch.manual_seed(0)
    node = translation("point_process").model_dump(mode="json") | {"conditions": conditions}
    network = SpeechToMotion(MotionTaskSettings.model_validate(node), NAMES, None, PERSONS).eval()
    network.head.normal.set(torch.zeros(3), 0.1)
    network.gaze.normalise_by(torch.zeros(6), 0.1)
    habits = MotionStyle((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (0.0, 0.0), (0.1, 0.1), 60.0, 20.0)
    rates = {"anna": 9.0, "bert": 12.0, "cleo": 31.0}
    manners = {name: replace(habits, blinks_per_min=rate) for name, rate in rates.items()}
    encoder = make_encoder(EmbedSettings.model_validate(EMBED))
    return Animator(encoder, NetworkGenerator(network), 25.0, speaker_styles=manners)


TOLD, UNTOLD = (
    animator([{"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.0, "gaze": 1.0}}]),
    animator([]),
)


def made(samples: int = 1, seed: int = 0, by: Animator = TOLD, **asked: Any) -> list[Animation]:
    return by.generate_from_embedding(SPEECH, samples, seed, 25.0, Controls(**asked))


def head(seed: int = 0, **asked: Any) -> np.ndarray:
    return made(1, seed, no_postprocessing=True, **asked)[0].motion.head


def test_model_is_conditioned_on_speaker_by_name_or_stored_style() -> None:
    assert TOLD.persons == PERSONS
    assert UNTOLD.persons == ()
    anna, bert = head(person="anna"), head(person="bert")
    assert np.abs(anna - bert).max() > 1e-4
    np.testing.assert_array_equal(anna, head(person="anna"))
    habits = TOLD.speaker_styles["bert"]
    named, same = (head(style=style, person=person) for style, person in (("bert", None), (habits, "bert")))
    np.testing.assert_array_equal(named, same)


@pytest.mark.long
def test_default_speaker_is_random_by_seed() -> None:
    as_each = {name: [head(seed, person=name) for seed in range(12)] for name in PERSONS}
    drawn = [head(seed) for seed in range(12)]
    who = [
        next(name for name in PERSONS if np.array_equal(as_each[name][seed], each)) for seed, each in enumerate(drawn)
    ]
    assert len(set(who)) > 1


def test_samples_are_takes_of_one_person() -> None:
    five = made(5, seed=3, no_postprocessing=True)
    (again,) = made(1, seed=3, no_postprocessing=True)
    np.testing.assert_allclose(five[0].motion.head, again.motion.head, atol=1e-6)
    assert np.abs(five[0].motion.head - five[1].motion.head).max() > 1e-3


def test_gaze_of_speakers_has_its_own_embedding_scale() -> None:
    same, more = (
        animator([{"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.0, "gaze": size}}])
        for size in (1.0, 3.0)
    )
    one, other = (made(1, 3, by, person="anna", no_postprocessing=True)[0].motion for by in (same, more))
    np.testing.assert_array_equal(one.head, other.head)
    assert np.abs(one.gaze - other.gaze).max() > 1e-3


@pytest.mark.parametrize("profile", [PHYSIOLOGICAL, PAPER])
def test_a_fraction_of_people_blinks_less_often(profile: Any) -> None:
    shares = (np.arange(2000) + 0.5) / 2000
    rates = np.array([blink_rate_quantile(profile, share) for share in shares])
    assert (np.diff(rates) >= 0).all()
    assert rates.min() > 0
    middle = rates.mean() if profile is PAPER else np.median(rates)
    assert middle == pytest.approx(profile.centre_per_min, rel=0.02)


@pytest.mark.long
def test_a_person_blinks_as_often_among_people_as_among_the_speakers() -> None:
    for rank, name in enumerate(PERSONS):
        counts = [len(each.events.blinks) for each in made(24, person=name)]
        assert np.mean(counts) == pytest.approx(blink_rate_quantile(PHYSIOLOGICAL, (rank + 0.5) / 3), rel=0.12)


@pytest.mark.parametrize(
    ("by", "said"), [(TOLD, "anna, bert, cleo"), (UNTOLD, "left out: the model is not conditioned")]
)
def test_a_person_whom_the_model_does_not_know_is_one_line(by: Animator, said: str) -> None:
    with pytest.raises(InputError, match=rf"^person: should be .*{said}.*, got dora$"):
        made(by=by, person="dora")


def test_a_number_is_a_person_who_stays() -> None:
    chosen = {TOLD._person(Controls(person=str(number)), seed) for number in range(20) for seed in (0, 1)}
    assert chosen == set(PERSONS)
    assert all(TOLD._person(Controls(person="7"), seed) == TOLD._person(Controls(person="7"), 0) for seed in range(9))


def dialogue_of(persons: str) -> AnimationOptions:
    return AnimationOptions(1, 0, 25.0, Controls(person=persons), previews=False)


def test_dialogue_has_two_speakers(tmp_path: Path) -> None:
    model = write_live_model(
        tmp_path / "model",
        PERSONS,
        conditions=[{"kind": "speaker", "condition_dropout": 0.0, "embedding_scale": {"head": 1.0, "gaze": 1.0}}],
    )
    sounds = [read_speech(sound_file(tmp_path / f"{seed}.wav", 1.0, seed)) for seed in range(2)]
    one, same, other = (
        run_dialogue(sounds, tmp_path / f"out{index}", dialogue_of(persons), model)[0]
        for index, persons in enumerate(("anna,cleo", "anna,bert", "bert,cleo"))
    )
    np.testing.assert_array_equal(one.first.motion.head, same.first.motion.head)
    np.testing.assert_array_equal(one.second.motion.head, other.second.motion.head)
    assert np.abs(one.first.motion.head - other.first.motion.head).max() > 1e-4
    asked = [json.loads((tmp_path / "out0" / name / "manifest.json").read_text()) for name in ("first", "second")]
    assert [each["controls"]["person"] for each in asked] == ["anna", "cleo"]
