"""Distances, speeds and intervals, compared with values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from talkingeyes.core.kinematics import eye_speed_deg_s, gaze_in_space_speed_deg_s, head_speed_deg_s, still_fraction
from talkingeyes.core.rotation import angles_to_gaze, eye_in_head, matrix_to_rotvec, rotvec_to_matrix
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    bootstrap,
    mean_statistic,
    quantile_statistic,
    ratio_statistic,
)
from talkingeyes.evaluation.papers.talkingeyes_metrics import distance, diversity, l2_error

SETTINGS = BootstrapSettings(n_resamples=400, confidence_level=0.95, seed=3)


def test_l2_by_hand_is_a_mean_of_norms_not_a_root_mean_square() -> None:
    reference = np.zeros((2, 6))
    samples = np.zeros((2, 2, 6))
    samples[0, 0, :2] = 3, 4  # norm 5 in the first frame, 0 in the second: mean 2.5, root mean square 3.54
    samples[1, :, 5] = 1  # norm 1 in both
    assert l2_error(samples, reference) == pytest.approx((2.5 + 1) / 2)
    assert l2_error(samples, reference, np.array([True, False])) == pytest.approx((5 + 1) / 2)


def test_diversity_by_hand() -> None:
    samples = np.zeros((3, 4, 3))
    samples[1, :, 0] = 1
    samples[2, :2, 1] = 2  # distances: 0-1: 1, 0-2: 1, 1-2: (2 sqrt 5 + 2) / 4
    assert diversity(samples) == pytest.approx((1 + 1 + (2 * np.sqrt(5) + 2) / 4) / 3)
    assert diversity(np.repeat(samples[:1], 5, axis=0)) == 0
    assert np.isnan(diversity(samples[:1]))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(2, 6))
def test_distances_are_symmetric_and_scale(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    samples = rng.normal(size=(count, 9, 6))
    assert distance(samples[0], samples[1]) == pytest.approx(distance(samples[1], samples[0]))
    assert diversity(samples[::-1]) == pytest.approx(diversity(samples))
    assert diversity(samples * 3 + 1) == pytest.approx(3 * diversity(samples))


def test_speed_of_a_ramp_is_in_degrees_a_second() -> None:
    yaw = np.radians(np.arange(50) * 0.4)  # 0.4 degrees per frame at 25 fps: 10 degrees per second
    gaze = angles_to_gaze(np.stack([np.stack([yaw, yaw * 0], -1)] * 2, axis=1))
    head = np.stack([np.zeros(50), np.zeros(50), np.radians(np.arange(50) * 0.2)], axis=-1)  # roll alone
    assert eye_speed_deg_s(gaze, 25.0) == pytest.approx(np.full(49, 10.0))
    assert head_speed_deg_s(head, 25.0) == pytest.approx(np.full(49, 5.0))
    assert eye_speed_deg_s(np.stack([gaze, gaze[::-1]]), 25.0) == pytest.approx(np.full((2, 49), 10.0))


def test_counter_rotating_eyes_move_in_the_head_and_rest_in_space() -> None:
    head = np.stack([np.zeros(40), np.radians(np.linspace(0, 20, 40)), np.zeros(40)], axis=-1)
    gaze = eye_in_head(head, np.zeros((40, 2, 2)))
    assert still_fraction(eye_speed_deg_s(gaze, 25.0)) == 0
    assert still_fraction(gaze_in_space_speed_deg_s(head, gaze, 25.0)) == 1


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000))
def test_speed_in_space_does_not_depend_on_where_the_world_looks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    head, gaze = rng.normal(0, 0.2, (12, 3)), rng.normal(0, 0.2, (12, 2, 3))
    turned = matrix_to_rotvec(rotvec_to_matrix(rng.normal(0, 1, 3)) @ rotvec_to_matrix(head))
    assert gaze_in_space_speed_deg_s(turned, gaze, 25.0) == pytest.approx(
        gaze_in_space_speed_deg_s(head, gaze, 25.0), abs=1e-6
    )
    assert head_speed_deg_s(turned, 25.0) == pytest.approx(head_speed_deg_s(head, 25.0), abs=1e-6)


def test_still_counts_frames_below_the_threshold() -> None:
    assert still_fraction(np.array([0.0, 2.4, 2.6, 100.0])) == 0.5


def test_interval_has_nominal_coverage() -> None:
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(200):
        estimate = bootstrap(mean_statistic(rng.normal(5, 2, 40)), 40, SETTINGS)
        inside += estimate.low <= 5 <= estimate.high
    assert 175 <= inside <= 199


def test_bootstrap_is_seeded_and_paired() -> None:
    values = np.random.default_rng(1).normal(1, 0.5, 30)
    assert bootstrap(mean_statistic(values), 30, SETTINGS) == bootstrap(mean_statistic(values), 30, SETTINGS)
    double = bootstrap(ratio_statistic(2 * values, values), 30, SETTINGS)
    assert (double.value, double.low, double.high) == pytest.approx((2, 2, 2))


def test_quantile_is_that_of_the_pooled_frames() -> None:
    rng = np.random.default_rng(2)
    groups = [rng.exponential(10, size) for size in (100, 300, 50)]
    statistic = quantile_statistic(groups, 0.99)
    for clips in ([0, 1, 2], [2, 2, 0]):
        pooled = np.concatenate([groups[clip] for clip in clips])
        expected = np.quantile(pooled, 0.99, method="inverted_cdf")
        assert statistic(np.array(clips)) == pytest.approx(expected)
