"""Rank order of models in two corpora."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipelines import second_world
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.benchmark.rank_agreement import error, rank_agreements, total_agreement
from talkingeyes.evaluation.benchmark.table import METRICS_BY_NAME
from talkingeyes.evaluation.bootstrap import Estimate

RATE, FRECHET, COVERAGE = (METRICS_BY_NAME[name] for name in ("saccades/rate", "features/frechet", "features/coverage"))


def row(metric, value: float, half: float = 0.1) -> MetricResult:
    estimate = Estimate(value, value - half, value + half)
    return MetricResult(metric, 100, estimate, Estimate(0.0, 0.0, 0.0), estimate if metric is RATE else None)


def results(*values: float, metric=RATE, half: float = 0.1):
    return {f"model {index}": [row(metric, value, half)] for index, value in enumerate(values)}


def test_error_follows_the_direction_of_the_metric() -> None:
    for one, expected in (
        (row(RATE, -0.5), (0.5, 0.4, 0.6)),
        (row(RATE, 0.05), (0.05, 0.0, 0.15)),
        (row(FRECHET, 2.0), (2.0, 1.9, 2.1)),
        (row(COVERAGE, 0.5), (-0.5, -0.6, -0.4)),
    ):
        found = error(one)
        assert found is not None and (found.value, found.low, found.high) == pytest.approx(expected)
    assert error(MetricResult(RATE, 0, None, None, None)) is None


def test_same_and_reversed_orders() -> None:
    one = results(1.0, 2.0, 3.0, 4.0)
    (same,) = rank_agreements(one, results(-10.0, -20.0, 30.0, 40.0))  # closer: the sign does not count
    assert (same.metric, same.models, same.apart, same.agreeing) == ("saccades/rate", 4, 6, 6)
    assert same.tau == pytest.approx(1.0)
    (reverse,) = rank_agreements(one, results(4.0, 3.0, 2.0, 1.0))
    assert (reverse.tau, reverse.apart, reverse.agreeing) == (pytest.approx(-1.0), 6, 0)


def test_overlapping_intervals_are_not_apart_and_equal_errors_have_no_order() -> None:
    one = results(1.0, 2.0, 3.0, 4.0)
    (wide,) = rank_agreements(one, results(1.0, 2.0, 3.0, 4.0, half=0.6))
    assert (wide.tau, wide.apart) == (pytest.approx(1.0), 3)
    (equal,) = rank_agreements(one, results(1.0, 1.0, 1.0, 1.0))
    assert equal.tau is None and equal.apart == 0
    median, apart, agreeing = total_agreement([wide, equal])
    assert (median, apart, agreeing) == (pytest.approx(1.0), 3, 3) and math.isnan(total_agreement([])[0])


def test_models_without_a_value_are_left_out() -> None:
    one, other = results(1.0, 2.0, 3.0, 4.0, 5.0), results(1.0, 2.0, np.nan, 4.0, 5.0)
    assert [each.models for each in rank_agreements(one, other)] == [4]
    assert rank_agreements(results(1.0, 2.0, 3.0), results(1.0, 2.0, 3.0)) == []


def test_the_spread_of_random_orders_is_kendall_s() -> None:
    from scipy.stats import kendalltau

    rng = np.random.default_rng(0)
    taus = [kendalltau(rng.permutation(9), rng.permutation(9)).statistic for _ in range(2000)]
    assert np.std(taus) == pytest.approx(second_world.random_spread(9), rel=0.05)


def test_a_missing_benchmark_is_one_line(tmp_path) -> None:
    with pytest.raises(InputError, match="should hold the benchmark of vae, got none; `make report` makes it"):
        second_world.read_benchmarks(tmp_path, ["vae"])
