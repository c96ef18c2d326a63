"""What frames cannot teach: the head's part in far gaze, small saccades, and how large one can be."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.performance.course import Course, fixations, lawful
from talkingeyes.performance.events import staircase
from talkingeyes.performance.oculomotor import LARGEST_RAD, SEEN_DEG, UNSEEN, accompanied, capped, scanned
from talkingeyes.physiology import saccades

FPS = 25.0


def course(onsets_s: list[float], places_deg: list[float], seconds: float = 6.0) -> Course:
    """Gaze ahead, then at each yaw from its onset on, over a head that is still."""
    yaw = np.radians([0.0, *places_deg])
    jumps = tuple(
        lawful(onset, np.array([start, 0.0]), np.array([end - start, 0.0]))
        for onset, start, end in zip(onsets_s, yaw, yaw[1:], strict=False)
    )
    times = np.arange(int(seconds * FPS)) / FPS
    space = np.repeat(staircase(jumps, times)[:, None], 2, axis=1)
    return Course(FPS, np.zeros((len(times), 3)), space, jumps)


def head_yaw_deg(made: Course) -> Float[ndarray, " T"]:
    return np.asarray(np.degrees(made.head[:, 1]))


def test_the_head_goes_along_where_gaze_is_far_and_comes_back_with_it() -> None:
    own = course([1.0, 4.0], [25.0, 0.0])
    yaw = head_yaw_deg(accompanied(own))
    np.testing.assert_allclose(yaw[: int(1.0 * FPS)], 0.0, atol=1e-6)
    np.testing.assert_allclose(yaw[int(2.0 * FPS) : int(4.0 * FPS)], 0.6 * 12.5, atol=0.01)
    np.testing.assert_allclose(yaw[int(5.0 * FPS) :], 0.0, atol=1e-6)
    np.testing.assert_array_equal(accompanied(own).space_rad, own.space_rad)  # the eyes make up for it


@pytest.mark.parametrize(("places_deg", "onsets_s"), [([12.0, 0.0], [1.0, 4.0]), ([25.0, 0.0], [1.0, 1.4])])
def test_the_head_stays_for_what_is_near_and_for_glances(places_deg: list[float], onsets_s: list[float]) -> None:
    np.testing.assert_allclose(head_yaw_deg(accompanied(course(onsets_s, places_deg))), 0.0, atol=1e-6)


def test_a_saccade_beyond_those_of_talk_falls_short_and_is_made_up_for() -> None:
    made = capped(course([1.0, 3.0], [-20.0, 20.0]))
    sizes = np.hypot(*made.steps_rad.T)
    assert len(sizes) == 3
    assert sizes.max() <= LARGEST_RAD + 1e-9
    np.testing.assert_allclose(np.degrees(made.together_rad[-1]), [20.0, 0.0], atol=1e-6)


def test_one_that_is_followed_at_once_falls_short_alone() -> None:
    made = capped(course([1.0, 2.0, 2.3], [-20.0, 20.0, 10.0]))
    np.testing.assert_allclose(np.degrees(made.steps_rad[:, 0]), [-20.0, 27.5, 2.5], atol=1e-6)


def test_what_is_small_enough_stays_as_it_is() -> None:
    own = course([1.0], [20.0])
    assert capped(own) is own


def test_small_saccades_come_within_fixations_by_the_law() -> None:
    onsets = [0.5 + index for index in range(400)]
    own = course(onsets, [5.0 * (index % 2 == 0) for index in range(400)], seconds=401.0)
    made = scanned(own, [7])
    kept = np.isin([each.onset_s for each in made.saccades], onsets)
    small = np.degrees(np.hypot(*made.steps_rad.T))[~kept]
    assert kept.sum() == 400
    assert len(small) / len(kept) == pytest.approx(UNSEEN, rel=0.25)
    drawn = saccades.draw_amplitudes_rad(50_000, np.random.default_rng(0))
    assert pytest.approx((drawn < np.radians(SEEN_DEG)).mean(), abs=0.01) == UNSEEN
    assert small.max() < 2 * SEEN_DEG
    assert np.median(small) < SEEN_DEG
    gaps = np.diff([each.onset_s for each in made.saccades])
    assert gaps.min() > 0.15
    landed = fixations(made, made.together_rad).place_rad[1:][kept]
    np.testing.assert_allclose(np.degrees(landed[:, 0]), [5.0 * (index % 2 == 0) for index in range(400)], atol=0.01)


def test_the_same_seeds_scan_alike_and_still_gaze_stays_still() -> None:
    own = course([float(index) for index in range(1, 40)], [4.0 * (index % 2) for index in range(39)], 40.0)
    np.testing.assert_array_equal(scanned(own, [3]).space_rad, scanned(own, [3]).space_rad)
    assert np.abs(scanned(own, [3]).space_rad - scanned(own, [4]).space_rad).max() > 0
    still = course([], [])
    assert scanned(still, [3]) is still
