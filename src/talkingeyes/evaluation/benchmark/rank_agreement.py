"""Agreement of the rank order of models between two corpora, metric by metric, with Kendall's tau.

Models are ordered by their error in a metric: the distance to the truth of the corpus where closer is better, else the
value (negative where higher is better). A pair of models is apart if the intervals of their errors do not overlap.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.benchmark.metric import CLOSER, LOWER
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import Estimate

MIN_MODELS = 4
Results = Mapping[str, Sequence[MetricResult]]  # of all models, by name


@dataclass(frozen=True)
class RankAgreement:
    """Agreement in one metric, over the `models` that have a value in both corpora.

    `tau` is Kendall's tau-b, None if all models have the same error. Of the `apart` pairs of models that are apart in
    both corpora, `agreeing` have the same order.
    """

    metric: str
    models: int
    tau: float | None
    apart: int
    agreeing: int


def rank_agreements(one: Results, other: Results) -> list[RankAgreement]:
    """Agreement of two corpora in every metric that at least MIN_MODELS models have in both."""
    found = []
    errors = _errors(one), _errors(other)
    for metric in METRICS:
        both = [each.get(metric.name, {}) for each in errors]
        models = [name for name in one if all(name in each for each in both)]
        if len(models) >= MIN_MODELS:
            found.append(_agreement(metric.name, *([each[name] for name in models] for each in both)))
    return found


def error(row: MetricResult) -> Estimate | None:
    """Error of a model in a metric, with its interval: the smaller, the better. None where there is no value."""
    if row.metric.direction != CLOSER:
        value, sign = row.value, 1 if row.metric.direction == LOWER else -1
        return value and Estimate(sign * value.value, *sorted((sign * value.low, sign * value.high)))
    if row.difference is None:
        return None
    low, high = sorted((abs(row.difference.low), abs(row.difference.high)))
    return Estimate(abs(row.difference.value), 0.0 if row.difference.low <= 0 <= row.difference.high else low, high)


def _errors(results: Results) -> dict[str, dict[str, Estimate]]:
    """Finite errors by metric and model."""
    found: dict[str, dict[str, Estimate]] = {}
    for model, rows in results.items():
        for row in rows:
            if (value := error(row)) is not None and np.isfinite(value.value):
                found.setdefault(row.metric.name, {})[model] = value
    return found


def _agreement(metric: str, one: Sequence[Estimate], other: Sequence[Estimate]) -> RankAgreement:
    from scipy.stats import kendalltau

    tau = float(kendalltau(*([each.value for each in side] for side in (one, other))).statistic)
    orders = [tuple(_order(side[a], side[b]) for side in (one, other)) for a, b in combinations(range(len(one)), 2)]
    apart = [order for order in orders if all(order)]
    agreeing = sum(first == second for first, second in apart)
    return RankAgreement(metric, len(one), tau if np.isfinite(tau) else None, len(apart), agreeing)


def _order(one: Estimate, other: Estimate) -> int:
    """-1 or 1 if the first or the second is better by more than the intervals, else 0."""
    return int(other.high < one.low) - int(one.high < other.low)


def total_agreement(found: Iterable[RankAgreement]) -> tuple[float, int, int]:
    """Median tau of some metrics, their pairs that are apart in both corpora, and those of them in the same order."""
    rows = list(found)
    taus = [each.tau for each in rows if each.tau is not None]
    return (
        float(np.median(taus)) if taus else np.nan,
        sum(each.apart for each in rows),
        sum(each.agreeing for each in rows),
    )
