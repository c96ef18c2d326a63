"""Rule-based layers: head contribution to eccentric gaze, saccadic intrusions, largest saccade amplitude."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, main_sequence_saccade
from talkingeyes.animation.saccade_resampling import saccade_staircase
from talkingeyes.animation.steps.amplitude_limit import MAX_AMPLITUDE_RAD, limit_amplitude
from talkingeyes.animation.steps.head_contribution import add_head_contribution
from talkingeyes.animation.steps.saccadic_intrusions import (
    INTRUSIONS_PER_S,
    MIN_FITTED_DEG,
    MIN_FIXATION_S,
    add_saccadic_intrusions,
)

FPS = 25.0


def context(gain: float = 1.0, seed: int = 0) -> AnimationContext:
    return AnimationContext(Controls(liveliness=Liveliness(gaze=gain)), seeds=(0, seed))


def trajectory(onsets_s: list[float], places_deg: list[float], seconds: float = 6.0) -> GazeTrajectory:
    """Gaze straight ahead, then at each yaw from its onset, with a still head."""
    yaw = np.radians([0.0, *places_deg])
    jumps = tuple(
        main_sequence_saccade(onset, np.array([start, 0.0]), np.array([end - start, 0.0]))
        for onset, start, end in zip(onsets_s, yaw, yaw[1:], strict=False)
    )
    times = np.arange(int(seconds * FPS)) / FPS
    space = np.repeat(saccade_staircase(jumps, times)[:, None], 2, axis=1)
    return GazeTrajectory(FPS, np.zeros((len(times), 3)), space, jumps)


def head_yaw_deg(made: GazeTrajectory) -> Float[ndarray, " T"]:
    return np.asarray(np.degrees(made.head[:, 1]))


def test_head_contributes_to_eccentric_gaze_and_returns() -> None:
    own = trajectory([1.0, 4.0], [25.0, 0.0])
    yaw = head_yaw_deg(add_head_contribution(own, context()))
    np.testing.assert_allclose(yaw[: int(1.0 * FPS)], 0.0, atol=1e-6)
    np.testing.assert_allclose(yaw[int(2.0 * FPS) : int(4.0 * FPS)], 0.6 * 12.5, atol=0.01)
    np.testing.assert_allclose(yaw[int(5.0 * FPS) :], 0.0, atol=1e-6)
    np.testing.assert_array_equal(
        add_head_contribution(own, context()).gaze_in_space_rad, own.gaze_in_space_rad
    )  # the eyes make up for it


@pytest.mark.parametrize(("places_deg", "onsets_s"), [([12.0, 0.0], [1.0, 4.0]), ([25.0, 0.0], [1.0, 1.4])])
def test_the_head_stays_for_what_is_near_and_for_glances(places_deg: list[float], onsets_s: list[float]) -> None:
    np.testing.assert_allclose(
        head_yaw_deg(add_head_contribution(trajectory(onsets_s, places_deg), context())), 0.0, atol=1e-6
    )


def test_a_saccade_beyond_those_of_talk_falls_short_and_is_made_up_for() -> None:
    made = limit_amplitude(trajectory([1.0, 3.0], [-20.0, 20.0]), context())
    sizes = np.hypot(*made.steps_rad.T)
    assert len(sizes) == 3
    assert sizes.max() <= MAX_AMPLITUDE_RAD + 1e-9
    np.testing.assert_allclose(np.degrees(made.cyclopean_rad[-1]), [20.0, 0.0], atol=1e-6)


def test_one_that_is_followed_at_once_falls_short_alone() -> None:
    made = limit_amplitude(trajectory([1.0, 2.0, 2.3], [-20.0, 20.0, 10.0]), context())
    np.testing.assert_allclose(np.degrees(made.steps_rad[:, 0]), [-20.0, 27.5, 2.5], atol=1e-6)


def test_small_saccades_are_unchanged() -> None:
    own = trajectory([1.0], [20.0])
    assert limit_amplitude(own, context()) is own


def test_intrusions_occur_within_fixations_and_return() -> None:
    onsets = [0.5 + 4.0 * index for index in range(200)]
    own = trajectory(onsets, [5.0 * (index % 2 == 0) for index in range(200)], seconds=802.0)
    made = add_saccadic_intrusions(own, context(1.0, 7))
    times_s = np.array([each.onset_s for each in made.saccades])
    small = ~np.isin(times_s, onsets)
    steps_deg, times_s = np.degrees(made.steps_rad[small]), times_s[small]
    out, back = steps_deg[::2], steps_deg[1::2]
    # Of 18 per minute in the free part of fixations, those large enough to be fitted and those that overlap are
    # removed.
    most = INTRUSIONS_PER_S * 200 * (4.0 - 2 * 0.2 - 0.225)
    assert 0.75 * most < len(out) < most
    np.testing.assert_allclose(out + back, 0.0, atol=1e-9)
    assert (out[:, 1] == 0).all()
    assert 0.35 < (out[:, 0] > 0).mean() < 0.65
    assert np.abs(out).max() < MIN_FITTED_DEG
    assert 0.4 < np.abs(out[:, 0]).mean() < 0.6  # 0.6 including those large enough to be fitted
    assert 0.15 < np.median(times_s[1::2] - times_s[::2]) < 0.22
    assert (times_s[2::2] - times_s[1:-1:2]).min() >= MIN_FIXATION_S
    assert np.abs(times_s[:, None] - np.array(onsets)).min() >= MIN_FIXATION_S - 1e-9
    large = np.isin([each.onset_s for each in made.saccades], onsets)
    np.testing.assert_allclose(made.steps_rad[large], own.steps_rad, atol=1e-9)


def test_intrusions_by_the_same_seeds_are_the_same_and_gaze_that_is_still_has_none() -> None:
    own = trajectory([float(index) for index in range(1, 40, 3)], [4.0 * (index % 2) for index in range(13)], 40.0)
    made = add_saccadic_intrusions(own, context(1.0, 3))
    np.testing.assert_array_equal(
        add_saccadic_intrusions(own, context(1.0, 3)).gaze_in_space_rad, made.gaze_in_space_rad
    )
    assert np.abs(add_saccadic_intrusions(own, context(1.0, 4)).gaze_in_space_rad - made.gaze_in_space_rad).max() > 0
    half = add_saccadic_intrusions(own, context(0.5, 3)).cyclopean_rad - own.cyclopean_rad
    whole = made.cyclopean_rad - own.cyclopean_rad
    np.testing.assert_allclose(2.0 * np.ptp(half[:, 0]), np.ptp(whole[:, 0]), rtol=0.05)
    assert add_saccadic_intrusions(own, context(0.0, 3)) is own
    still = trajectory([], [])
    assert add_saccadic_intrusions(still, context(1.0, 3)) is still
