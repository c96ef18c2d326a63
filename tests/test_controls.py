"""Controls of an animation take effect: eye contact, liveliness, style; without controls nothing changes."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_performer import CALM_STYLE, LIVELY_STYLE, PERFORMER, SOUND, motion, perform_toy

from talkingeyes.animation.blink_sampling import gaze_evoked_blinks, spontaneous_blinks
from talkingeyes.animation.context import AnimationContext, sample_seeds
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.gaze_trajectory import GazeTrajectory
from talkingeyes.animation.steps.eye_contact import eye_contact_fraction
from talkingeyes.animation.targets import ObjectTrack, TargetTrack
from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.kinematics import gaze_in_space_speed_deg_s, head_speed_deg_s
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.fitting.motion_style import MotionStyle, load_speakers, mean_style, measure_style, save_speakers
from talkingeyes.physiology import eye_head, saccades
from talkingeyes.physiology.blinks import PAPER
from talkingeyes.training.motion_generators import Speech, TrainedGenerator
from talkingeyes.workflows.direct import measure_clip_style

CONTEXT = AnimationContext(Controls())
PAPER_CONTEXT = AnimationContext(Controls(), blink_profile=PAPER)


def eye_contact(made: Motion, x_m: float = 0.0) -> float:
    listener = np.tile([x_m, 0.0, 1.0, 1.0], (len(made), 1))
    return eye_contact_fraction(made.head, rotation.gaze_in_space(made.head, made.gaze), listener)


def test_eye_contact_is_the_requested_fraction() -> None:
    asked = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
    for seed in range(3):
        shares = [eye_contact(motion(seed, eye_contact=share)) for share in asked]
        np.testing.assert_allclose(shares, asked, atol=0.06)
        assert all(low <= high + 1e-9 for low, high in itertools.pairwise(shares))


def test_eye_contact_follows_location_of_listener() -> None:
    beside = TargetTrack((), {"listener": ObjectTrack.fixed(0.3, 0.0, 1.0)})
    made = motion(eye_contact=0.8, targets=beside)
    assert eye_contact(made, 0.3) == pytest.approx(0.8, abs=0.06)
    assert eye_contact(made, 0.0) < 0.3


@pytest.mark.parametrize(
    "asked", [{"eye_contact": 0.2}, {"eye_contact": 0.9}, {"liveliness": Liveliness(gaze=2.0)}, {"style": LIVELY_STYLE}]
)
def test_saccades_stay_on_the_main_sequence(asked: dict[str, Any]) -> None:
    (made,) = perform_toy(fps=120.0, **asked)
    speed = gaze_in_space_speed_deg_s(made.motion.head, made.motion.gaze, 120.0)
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


def test_liveliness_controls_increase_what_they_name() -> None:
    dials = (0.0, 0.5, 1.0, 1.5, 2.0)
    head, gaze, blinks = [], [], []
    for dial in dials:
        made = perform_toy(4, liveliness=Liveliness(dial, dial, dial))
        head.append(np.mean([head_speed_deg_s(each.motion.head, 25.0).mean() for each in made]))
        spaces = [rotation.gaze_in_space(each.motion.head, each.motion.gaze) for each in made]
        gaze.append(np.mean([rotation.cyclopean_gaze(space).std(axis=0).mean() for space in spaces]))
        blinks.append(np.mean([len(each.events.blinks) for each in made]))
    for measured_ in (head, gaze, blinks):
        assert measured_[0] == pytest.approx(0.0, abs=1e-3)
        assert all(low < high for low, high in itertools.pairwise(measured_))
    np.testing.assert_allclose(np.array(head) / head[2], dials, rtol=0.02, atol=1e-6)
    np.testing.assert_allclose(np.array(gaze[:4]) / gaze[2], dials[:4], rtol=0.12, atol=1e-3)
    np.testing.assert_allclose(np.array(blinks) / blinks[2], dials, rtol=0.25)


def course_of(shifts: int, *amplitudes_deg: float) -> GazeTrajectory:
    """2,000 seconds of a still head with a gaze shift every ten seconds, of these sizes in turn."""
    rng, to = np.random.default_rng(0), np.radians([[size, 0.0] for size in amplitudes_deg])
    made = [saccades.sample_saccade(10.0 * k, np.zeros(2), to[k % len(to)], rng) for k in range(shifts)]
    return GazeTrajectory(25.0, np.zeros((50_000, 3)), np.zeros((50_000, 2, 2)), tuple(made))


def test_large_gaze_shifts_evoke_blinks() -> None:
    """Evinger et al.: 0.69 of shifts of 25 degrees evoke blinks; small ones none; none if off or with profile paper."""
    rng = np.random.default_rng(0)
    brought = gaze_evoked_blinks(course_of(200, 25.0), 20.0, CONTEXT, rng)
    assert len(brought) / 200 == pytest.approx(0.69, abs=0.1)
    late_s = np.array([blink.onset_s for blink in brought]) % 10.0
    assert np.minimum(late_s, 10.0 - late_s).max() <= 0.03
    assert not gaze_evoked_blinks(course_of(200, 4.0), 20.0, CONTEXT, rng)
    assert not gaze_evoked_blinks(course_of(200, 25.0), 0.0, CONTEXT, rng)
    assert not gaze_evoked_blinks(course_of(200, 25.0), 20.0, PAPER_CONTEXT, rng)


def test_gaze_evoked_blinks_are_not_removed_by_others() -> None:
    """Gaze shifts by 25 degrees and back every two seconds, for a speaker with a high blink rate."""

    class Aside(TrainedGenerator):
        def sample(self, speech: Speech) -> Samples:
            samples, frames = len(speech.seeds), len(speech.embedding)
            gaze = np.zeros((samples, frames, 2, 3))
            gaze[..., 1] = np.radians(25.0) * (np.arange(frames) // 50 % 2)[:, None]
            return Samples(speech.fps, np.zeros((samples, frames, 3)), gaze)

    aside = replace(PERFORMER, generator=Aside())
    asked = Controls(liveliness=Liveliness(blinks=2.0), no_postprocessing=True)
    brought, shifts = 0, 0
    for made in aside.perform(SOUND, 40, 0, 25.0, asked):
        onsets_s = np.array([blink.onset_s for blink in made.events.blinks])
        shifts += len(made.events.saccades)
        brought += sum(np.abs(onsets_s - each.onset_s).min() < 0.04 for each in made.events.saccades)
    assert shifts > 400
    assert brought / shifts == pytest.approx(0.7, abs=0.06)


def test_low_blink_rate_keeps_blinks_of_largest_shifts() -> None:
    """Evinger et al. expect 69 and 17 of 100 each; of 67 blinks in all a quarter occur without a shift: 50 remain."""
    rng, trajectory = np.random.default_rng(2), course_of(200, 25.0, 10.0)
    brought = [blink.onset_s for _ in range(10) for blink in gaze_evoked_blinks(trajectory, 2.0, CONTEXT, rng)]
    large = np.round(np.array(brought) / 10.0) % 2 == 0
    assert len(brought) / 10 == pytest.approx(50, rel=0.1)
    assert large.all()


@pytest.mark.parametrize("rate", [3.0, 20.0])
def test_blink_rate_includes_gaze_evoked_blinks(rate: float) -> None:
    """The blink rate is kept even if shifts would evoke more: here 4 per minute."""
    trajectory, rng = course_of(200, 25.0), np.random.default_rng(1)
    brought = gaze_evoked_blinks(trajectory, rate, CONTEXT, rng)
    assert len(brought) <= 0.9 * rate * trajectory.seconds / 60
    drawn = [
        *brought,
        *spontaneous_blinks(trajectory.seconds, rate, brought, CONTEXT, rng),
    ]
    assert 60 * len(drawn) / trajectory.seconds == pytest.approx(rate, rel=0.2)


def test_without_postprocessing_head_and_gaze_are_those_of_the_model() -> None:
    blinkless = Liveliness(blinks=0.0)
    made, laid_over = (motion(3, no_postprocessing=each, liveliness=blinkless) for each in (True, False))
    drawn = PERFORMER.generator.generate(np.zeros((len(made), 1)), sample_seeds(3, 1), 25.0)
    np.testing.assert_allclose(made.head, drawn.head[0], atol=1e-9)
    np.testing.assert_allclose(made.gaze, eye_head.clamp_to_eye_range(drawn.gaze[0]), atol=1e-6)
    assert np.abs(laid_over.gaze - drawn.gaze[0]).max() > np.radians(0.3)


def test_no_controls_change_nothing() -> None:
    (plain,) = PERFORMER.perform(SOUND, 1, 5, 25.0)
    (same,) = perform_toy(seed=5, liveliness=Liveliness(1.0, 1.0, 1.0))
    np.testing.assert_array_equal(plain.motion.gaze, same.motion.gaze)
    np.testing.assert_array_equal(plain.motion.head, same.motion.head)
    assert plain.events == same.events


def test_the_same_alone_or_in_a_batch() -> None:
    asked = {
        "eye_contact": 0.6, "style": "bob", "liveliness": Liveliness(1.5, 0.7, 2.0),
        "partner": np.random.default_rng(0).normal(0, 0.1, len(SOUND)).astype(np.float32),
    }  # fmt: skip
    alone, many = perform_toy(1, seed=2, **asked), perform_toy(3, seed=2, **asked)
    np.testing.assert_array_equal(alone[0].motion.gaze, many[0].motion.gaze)
    assert alone[0].events == many[0].events
    assert alone[0].events != many[1].events


@pytest.mark.parametrize(("name", "motion_style"), [("ann", CALM_STYLE), ("bob", LIVELY_STYLE)])
def test_a_style_imposes_what_was_measured(name: str, motion_style: MotionStyle) -> None:
    got = [measure_style(each.motion) for each in perform_toy(32, style=name)]
    for each in got[:8]:
        np.testing.assert_allclose(each.head_mean_rad, motion_style.head_mean_rad, atol=1e-3)
        np.testing.assert_allclose(each.head_sd_rad, motion_style.head_sd_rad, rtol=0.02)
        np.testing.assert_allclose(each.gaze_mean_rad, motion_style.gaze_mean_rad, atol=0.01)
        np.testing.assert_allclose(each.gaze_sd_rad, motion_style.gaze_sd_rad, rtol=0.1)
    assert np.mean([each.saccades_per_min for each in got]) == pytest.approx(motion_style.saccades_per_min, rel=0.15)
    assert np.mean([each.blinks_per_min for each in got]) == pytest.approx(motion_style.blinks_per_min, rel=0.25)


def test_a_reference_clip_is_a_style_at_any_frame_rate() -> None:
    clip = motion(seed=9, fps=60.0, style=LIVELY_STYLE)
    motion_style = measure_clip_style(clip)
    got = measure_style(motion(seed=1, style=motion_style))
    np.testing.assert_allclose(got.head_sd_rad, motion_style.head_sd_rad, rtol=0.02)
    np.testing.assert_allclose(got.gaze_sd_rad, motion_style.gaze_sd_rad, rtol=0.1)
    assert got.saccades_per_min == pytest.approx(motion_style.saccades_per_min, rel=0.15)


def test_a_clip_that_is_too_short_has_no_style() -> None:
    with pytest.raises(InputError, match=r"at least 1 s, got 0.40 s"):
        measure_clip_style(motion().cut(0, 10))


def test_speakers_are_kept_with_a_model(tmp_path: Path) -> None:
    save_speakers(tmp_path / "speakers.json", {"bob": LIVELY_STYLE, "ann": CALM_STYLE})
    assert load_speakers(tmp_path / "speakers.json") == {"ann": CALM_STYLE, "bob": LIVELY_STYLE}
    (tmp_path / "bad.json").write_text('{"ann": 3}')
    with pytest.raises(InputError, match="styles of speakers"):
        load_speakers(tmp_path / "bad.json")
    half = mean_style([CALM_STYLE, replace(CALM_STYLE, blinks_per_min=20.0)], [1.0, 3.0])
    assert half.blinks_per_min == pytest.approx(17.0)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"eye_contact": 1.2}, "eye_contact: should be 0"),
        ({"eye_contact": float("nan")}, "eye_contact: should be 0"),
        ({"liveliness": Liveliness(head=-0.1)}, "liveliness of head: should be 0"),
        ({"liveliness": Liveliness(gaze=float("inf"))}, "liveliness of gaze"),
        ({"liveliness": Liveliness(blinks=9.0)}, "liveliness of blinks"),
        ({"style": "cid"}, "style: should be one of ann, bob, got cid"),
        ({"blinks": "often"}, "blinks: should be one of"),
        ({"partner": np.array([np.nan])}, "partner: should be a sound"),
    ],
)
def test_bad_controls_are_one_line_error(asked: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        perform_toy(**asked)
    assert "\n" not in str(caught.value)


def test_embedded_speech_has_no_partner() -> None:
    with pytest.raises(InputError, match="partner: should come with the sound"):
        PERFORMER.generate_from_embedding(np.zeros((50, 1), np.float32), 1, 0, 25.0, Controls(partner=np.zeros(100)))
