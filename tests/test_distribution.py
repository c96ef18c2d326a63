"""Distances between distributions, compared with closed forms and scipy, and their required invariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from talkingeyes.core.energy_score import energy_score
from talkingeyes.evaluation.detectors.signal import spectrum
from talkingeyes.evaluation.measures.distribution import (
    Gaussian,
    WindowFeatures,
    frechet,
    mmd_statistic,
    permutation_p_value,
    precision_coverage,
    sample_windows,
    windowed_energy_score,
)

FPS = 25.0


def normal(seed: int, *shape: int) -> np.ndarray:
    """Standard normal samples."""
    return np.random.default_rng(seed).standard_normal(shape)


def test_frechet_of_commuting_gaussians_by_hand() -> None:
    one = Gaussian(np.array([1.0, 0.0]), np.diag([4.0, 1.0]))
    other = Gaussian(np.array([0.0, 2.0]), np.diag([1.0, 9.0]))
    assert frechet(one, other) == pytest.approx(1 + 4 + (2 - 1) ** 2 + (1 - 3) ** 2)
    assert frechet(one, one) == pytest.approx(0, abs=1e-9)


def clustered(seed: int, clips: int, shift: float = 0.0, own: float = 1.0) -> list[np.ndarray]:
    """Windows of clips, each clip with its own centre."""
    return [normal(seed + index, 1, 3) * own + normal(seed + 500 + index, 6, 3) * 0.3 + shift for index in range(clips)]


def mmd_of(one: WindowFeatures, other: WindowFeatures, paired: bool = False) -> float:
    """MMD^2 with each clip once."""
    return mmd_statistic(one, other, paired)(np.unique(np.concatenate([one.clip, other.clip])))


def test_mmd_of_one_distribution_is_zero_on_average_and_grows_with_a_shift() -> None:
    def value(seed: int, shift: float) -> float:
        one, other = (sample_windows(clustered(s, 30, d), 120, 0) for s, d in ((seed, shift), (seed + 2000, 0.0)))
        return mmd_of(one, other)

    same = [value(seed, 0.0) for seed in range(0, 60_000, 3000)]
    assert abs(np.mean(same)) < 3 * np.std(same) / np.sqrt(len(same))
    assert min(same) < 0
    assert np.mean(same) < value(0, 0.5) < value(0, 1.0)


def test_truth_against_itself_is_no_better_than_against_other_truth() -> None:
    one = sample_windows(clustered(0, 40), 200, 0)
    assert abs(mmd_of(one, one, paired=True)) < 1e-12


def test_permutation_test_permutes_whole_clips() -> None:
    """Windows of a clip are similar: a test that permuted windows would nearly always reject."""
    below = []
    for seed in range(0, 60_000, 1500):
        one, other = (sample_windows(clustered(s, 12), 72, 0) for s in (seed, seed + 700))
        below.append(permutation_p_value(one, other, 60, seed) < 0.1)
    assert np.mean(below) < 0.3
    one, other = sample_windows(clustered(0, 30, 1.0), 120, 0), sample_windows(clustered(900, 30), 120, 0)
    assert permutation_p_value(one, other, 99, 0) == pytest.approx(0.01)


def test_windows_are_sampled_evenly_and_limited_in_number() -> None:
    groups = [normal(index, 4 if index else 0, 2) for index in range(50)]
    drawn = sample_windows(groups, 98, 3)
    assert len(drawn.features) == 98
    assert (np.bincount(drawn.clip) == [0] + [2] * 49).all()
    assert len(sample_windows(groups, 20, 3).features) == 20
    for features, clip in zip(drawn.features, drawn.clip, strict=True):
        assert (features == groups[clip]).all(axis=1).any()


def test_energy_score_by_hand_and_against_the_integral_of_crps() -> None:
    samples = np.array([[0.0], [2.0], [4.0]])
    assert energy_score(samples, np.array([1.0])) == pytest.approx((1 + 1 + 3) / 3 - (2 + 4 + 2) / 3 / 2)
    assert np.isnan(energy_score(samples[:1], np.array([1.0])))
    drawn = normal(0, 4000, 1)
    expected = np.mean(np.sqrt(2 / np.pi) - 1 / np.sqrt(np.pi))  # the CRPS of N(0, 1) at 0 is 0.2337
    assert energy_score(drawn[:2000], np.zeros(1)) == pytest.approx(expected, abs=0.02)


def test_windowed_energy_score_penalises_frozen_samples() -> None:
    truth = np.repeat(normal(3, 60, 2), 5, axis=0)
    alive = np.repeat(normal(4, 10, 60, 2), 5, axis=1)
    frozen = np.repeat(normal(5, 10, 1, 2), 300, axis=1)
    scores = [windowed_energy_score(each, truth, 50).mean() for each in (alive, frozen)]
    assert scores[0] < scores[1]
    assert len(windowed_energy_score(alive, truth, 50)) == 6


def test_mean_is_precise_with_low_coverage_and_noise_the_opposite() -> None:
    truth = sample_windows(clustered(0, 60), 300, 0)
    other = precision_coverage(sample_windows(clustered(5000, 60), 300, 0), truth, 5)
    mean = precision_coverage(sample_windows([np.zeros((5, 3))] * 60, 300, 0), truth, 5)
    noise = precision_coverage(sample_windows(clustered(5000, 60, own=6.0), 300, 0), truth, 5)
    assert other.precise.mean() > 0.9
    assert other.covered.mean() > 0.9
    assert mean.precise.mean() == 1
    assert mean.covered.mean() < 0.4
    assert noise.precise.mean() < 0.6


def test_balls_use_neighbours_of_other_clips() -> None:
    truth = sample_windows([np.full((3, 2), 100.0 * index) for index in range(12)], 36, 0)
    near = sample_windows([np.full((1, 2), 240.0)], 1, 0)
    assert precision_coverage(near, truth, 2).precise.mean() == 1
    assert precision_coverage(near, truth, 2).covered.mean() == pytest.approx(2 / 12)


def test_spectrum_agrees_with_scipy() -> None:
    angles = np.cumsum(normal(0, 400, 3), axis=0) * 0.01
    found = spectrum(angles, FPS)
    frequency, density = signal.welch(np.degrees(angles), FPS, "hann", 64, detrend="linear", axis=0)
    assert found.frequency_hz == pytest.approx(frequency)
    assert (found.power / found.segments)[1:-1] == pytest.approx(density[1:-1])
    assert found.segments == 1 + (400 - 64) // 32


def test_segments_with_gaps_are_left_out() -> None:
    angles, valid = normal(0, 256, 2), np.ones(256, bool)
    valid[100] = False
    whole, gap = spectrum(angles, FPS), spectrum(angles, FPS, valid)
    assert gap.segments == whole.segments - 2
    assert spectrum(angles[:30], FPS).segments == 0
