"""What is asked of a performance is done: eye contact, liveliness, manner; nothing asked, nothing changed."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from directed import LIVELY, PERFORMER, QUIET, SOUND, motion, performed

from talkingeyes.animation.contact import share_of_contact
from talkingeyes.animation.course import Course
from talkingeyes.animation.direct import Asked, blinks_of, blinks_with
from talkingeyes.animation.direction import Direction, Liveliness
from talkingeyes.animation.manner import manner_of
from talkingeyes.animation.perform import sample_seeds
from talkingeyes.animation.targets import Place, TargetTrack
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import head_speed_deg_s, space_speed_deg_s
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.fitting.manner import Manner, in_all, load_speakers, measured, save_speakers
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.blinks import PAPER, PHYSIO


def contact(made: Motion, x_m: float = 0.0) -> float:
    listener = np.tile([x_m, 0.0, 1.0], (len(made), 1))
    return share_of_contact(made.head, rotation.gaze_in_space(made.head, made.gaze), listener)


def test_contact_is_the_share_that_is_asked_for_and_rises_with_it() -> None:
    asked = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
    for seed in range(3):
        shares = [contact(motion(seed, contact=share)) for share in asked]
        np.testing.assert_allclose(shares, asked, atol=0.06)
        assert all(low <= high + 1e-9 for low, high in itertools.pairwise(shares))


def test_contact_is_with_the_listener_wherever_that_is() -> None:
    beside = TargetTrack((), {"listener": Place.fixed(0.3, 0.0, 1.0)})
    made = motion(contact=0.8, targets=beside)
    assert contact(made, 0.3) == pytest.approx(0.8, abs=0.06)
    assert contact(made, 0.0) < 0.3


@pytest.mark.parametrize(
    "asked", [{"contact": 0.2}, {"contact": 0.9}, {"liveliness": Liveliness(gaze=2.0)}, {"style": LIVELY}]
)
def test_saccades_stay_on_the_main_sequence(asked: dict[str, Any]) -> None:
    (made,) = performed(fps=120.0, **asked)
    speed = space_speed_deg_s(made.motion.head, made.motion.gaze, 120.0)
    ratios = []
    for each, following in itertools.pairwise(made.events.saccades):
        size = float(np.hypot(*np.subtract(each.end_rad, each.start_rad)))
        assert each.duration_s == pytest.approx(float(saccades.duration_s(size)))
        apart = following.onset_s > each.onset_s + 0.15
        if np.radians(2.5) < size < np.radians(20) and apart:
            around = slice(max(int(each.onset_s * 120) - 1, 0), int((each.onset_s + each.duration_s) * 120) + 2)
            ratios.append(speed[around].max() / np.degrees(saccades.peak_speed(size)))
    assert len(ratios) > 4
    assert 0.8 < np.median(ratios) < 1.1


def test_dials_rise_with_what_they_name() -> None:
    dials = (0.0, 0.5, 1.0, 1.5, 2.0)
    head, gaze, blinks = [], [], []
    for dial in dials:
        made = performed(4, liveliness=Liveliness(dial, dial, dial))
        head.append(np.mean([head_speed_deg_s(each.motion.head, 25.0).mean() for each in made]))
        spaces = [rotation.gaze_in_space(each.motion.head, each.motion.gaze) for each in made]
        gaze.append(np.mean([rotation.conjugate(space).std(axis=0).mean() for space in spaces]))
        blinks.append(np.mean([len(each.events.blinks) for each in made]))
    for measured_ in (head, gaze, blinks):
        assert measured_[0] == pytest.approx(0.0, abs=1e-3)
        assert all(low < high for low, high in itertools.pairwise(measured_))
    np.testing.assert_allclose(np.array(head) / head[2], dials, rtol=0.02, atol=1e-6)
    np.testing.assert_allclose(np.array(gaze[:4]) / gaze[2], dials[:4], rtol=0.12, atol=1e-3)
    np.testing.assert_allclose(np.array(blinks) / blinks[2], dials, rtol=0.25)


def course_of(shifts: int, *amplitudes_deg: float) -> Course:
    """2,000 seconds of a still head, with shifts of gaze every ten, of these sizes in turn."""
    random, to = np.random.default_rng(0), np.radians([[size, 0.0] for size in amplitudes_deg])
    made = [saccades.saccade(10.0 * k, np.zeros(2), to[k % len(to)], random) for k in range(shifts)]
    return Course(25.0, np.zeros((50_000, 3)), np.zeros((50_000, 2, 2)), tuple(made))


def test_large_shifts_of_gaze_bring_blinks() -> None:
    """By Evinger: .69 of those of 25 degrees; no small ones, none where none are asked for, none by the paper."""
    random = np.random.default_rng(0)
    brought = blinks_with(PHYSIO, course_of(200, 25.0), 20.0, random)
    assert len(brought) / 200 == pytest.approx(0.69, abs=0.1)
    late_s = np.array([blink.onset_s for blink in brought]) % 10.0
    assert np.minimum(late_s, 10.0 - late_s).max() <= 0.03
    assert not blinks_with(PHYSIO, course_of(200, 4.0), 20.0, random)
    assert not blinks_with(PHYSIO, course_of(200, 25.0), 0.0, random)
    assert not blinks_with(PAPER, course_of(200, 25.0), 20.0, random)


def test_blinks_that_shifts_bring_are_not_lost_to_others() -> None:
    """Gaze goes 25 degrees aside and back every two seconds, of somebody who blinks much."""

    class Aside:
        def generate(self, embedding: Any, seeds: list[int], fps: float, given: Any = None) -> Samples:
            gaze = np.zeros((len(seeds), len(embedding), 2, 3))
            gaze[..., 1] = np.radians(25.0) * (np.arange(len(embedding)) // 50 % 2)[:, None]
            return Samples(fps, np.zeros((len(seeds), len(embedding), 3)), gaze)

    aside = replace(PERFORMER, generator=Aside())
    asked = Direction(liveliness=Liveliness(blinks=2.0), as_drawn=True)
    brought, shifts = 0, 0
    for made in aside.perform(SOUND, 40, 0, 25.0, asked):
        onsets_s = np.array([blink.onset_s for blink in made.events.blinks])
        shifts += len(made.events.saccades)
        brought += sum(np.abs(onsets_s - each.onset_s).min() < 0.04 for each in made.events.saccades)
    assert shifts > 400
    assert brought / shifts == pytest.approx(0.7, abs=0.06)


def test_who_blinks_little_does_so_with_the_largest_shifts() -> None:
    """By Evinger 69 and 17 of 100 each would, of 67 that there are, a quarter of them without a shift: 50."""
    random, course = np.random.default_rng(2), course_of(200, 25.0, 10.0)
    brought = [blink.onset_s for _ in range(10) for blink in blinks_with(PHYSIO, course, 2.0, random)]
    large = np.round(np.array(brought) / 10.0) % 2 == 0
    assert len(brought) / 10 == pytest.approx(50, rel=0.1)
    assert large.all()


@pytest.mark.parametrize("rate", [3.0, 20.0])
def test_with_blinks_that_shifts_bring_there_are_as_many_as_asked_for(rate: float) -> None:
    """However many the shifts would bring: here 4 a minute."""
    course, random = course_of(200, 25.0), np.random.default_rng(1)
    brought = blinks_with(PHYSIO, course, rate, random)
    assert len(brought) <= 0.9 * rate * course.seconds / 60
    drawn = [*brought, *blinks_of(PHYSIO, Asked(Direction()), course.seconds, rate, brought, random)]
    assert 60 * len(drawn) / course.seconds == pytest.approx(rate, rel=0.2)


def test_as_drawn_head_and_gaze_are_the_models_own() -> None:
    blinkless = Liveliness(blinks=0.0)
    made, laid_over = (motion(3, as_drawn=each, liveliness=blinkless) for each in (True, False))
    drawn = PERFORMER.generator.generate(np.zeros((len(made), 1)), sample_seeds(3, 1), 25.0)
    np.testing.assert_allclose(made.head, drawn.head[0], atol=1e-9)
    np.testing.assert_allclose(made.gaze, eye_head.within_range(drawn.gaze[0]), atol=1e-6)
    assert np.abs(laid_over.gaze - drawn.gaze[0]).max() > np.radians(0.3)


def test_nothing_asked_nothing_changed() -> None:
    (plain,) = PERFORMER.perform(SOUND, 1, 5, 25.0)
    (same,) = performed(seed=5, liveliness=Liveliness(1.0, 1.0, 1.0))
    np.testing.assert_array_equal(plain.motion.gaze, same.motion.gaze)
    np.testing.assert_array_equal(plain.motion.head, same.motion.head)
    assert plain.events == same.events


def test_the_same_alone_or_in_a_batch() -> None:
    asked = {
        "contact": 0.6, "style": "bob", "liveliness": Liveliness(1.5, 0.7, 2.0),
        "partner": np.random.default_rng(0).normal(0, 0.1, len(SOUND)).astype(np.float32),
    }  # fmt: skip
    alone, many = performed(1, seed=2, **asked), performed(3, seed=2, **asked)
    np.testing.assert_array_equal(alone[0].motion.gaze, many[0].motion.gaze)
    assert alone[0].events == many[0].events
    assert alone[0].events != many[1].events


@pytest.mark.parametrize(("name", "manner"), [("ann", QUIET), ("bob", LIVELY)])
def test_a_style_imposes_what_was_measured(name: str, manner: Manner) -> None:
    got = [measured(each.motion) for each in performed(32, style=name)]
    for each in got[:8]:
        np.testing.assert_allclose(each.head_mean_rad, manner.head_mean_rad, atol=1e-3)
        np.testing.assert_allclose(each.head_sd_rad, manner.head_sd_rad, rtol=0.02)
        np.testing.assert_allclose(each.gaze_mean_rad, manner.gaze_mean_rad, atol=0.01)
        np.testing.assert_allclose(each.gaze_sd_rad, manner.gaze_sd_rad, rtol=0.1)
    assert np.mean([each.saccades_per_min for each in got]) == pytest.approx(manner.saccades_per_min, rel=0.15)
    assert np.mean([each.blinks_per_min for each in got]) == pytest.approx(manner.blinks_per_min, rel=0.25)


def test_a_reference_clip_is_a_style_at_any_frame_rate() -> None:
    clip = motion(seed=9, fps=60.0, style=LIVELY)
    manner = manner_of(clip)
    got = measured(motion(seed=1, style=manner))
    np.testing.assert_allclose(got.head_sd_rad, manner.head_sd_rad, rtol=0.02)
    np.testing.assert_allclose(got.gaze_sd_rad, manner.gaze_sd_rad, rtol=0.1)
    assert got.saccades_per_min == pytest.approx(manner.saccades_per_min, rel=0.15)


def test_a_clip_that_is_too_short_has_no_style() -> None:
    with pytest.raises(InputError, match=r"at least 1 s, got 0.40 s"):
        manner_of(motion().cut(0, 10))


def test_speakers_are_kept_with_a_model(tmp_path: Path) -> None:
    save_speakers(tmp_path / "speakers.json", {"bob": LIVELY, "ann": QUIET})
    assert load_speakers(tmp_path / "speakers.json") == {"ann": QUIET, "bob": LIVELY}
    (tmp_path / "bad.json").write_text('{"ann": 3}')
    with pytest.raises(InputError, match="habits of speakers"):
        load_speakers(tmp_path / "bad.json")
    half = in_all([QUIET, replace(QUIET, blinks_per_min=20.0)], [1.0, 3.0])
    assert half.blinks_per_min == pytest.approx(17.0)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"contact": 1.2}, "contact: should be 0"),
        ({"contact": float("nan")}, "contact: should be 0"),
        ({"liveliness": Liveliness(head=-0.1)}, "liveliness of head: should be 0"),
        ({"liveliness": Liveliness(gaze=float("inf"))}, "liveliness of gaze"),
        ({"liveliness": Liveliness(blinks=9.0)}, "liveliness of blinks"),
        ({"style": "cid"}, "style: should be one of ann, bob, got cid"),
        ({"blinks": "often"}, "blinks: should be one of"),
        ({"partner": np.array([np.nan])}, "partner: should be a sound"),
    ],
)
def test_what_will_not_do_is_one_clear_line(asked: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        performed(**asked)
    assert "\n" not in str(caught.value)


def test_embedded_speech_has_no_partner() -> None:
    with pytest.raises(InputError, match="partner: should come with the sound"):
        PERFORMER.perform_embedded(np.zeros((50, 1), np.float32), 1, 0, 25.0, Direction(partner=np.zeros(100)))
