"""Benchmark over many clips: sums in groups, bootstrap over the groups, one result for each metric.

A clip here is a sound with all its motions (samples of a model, takes of the truth): the bootstrap resamples sounds,
not samples. With more than MAX_GROUPS clips, several share a group, so memory does not grow with the corpus; resampling
groups of clips gives an interval of the same width.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.registry import EXTRACTORS, METRICS
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    Estimate,
    bootstrap,
    percentile_interval,
    resample_indices,
)
from talkingeyes.evaluation.detectors.behaviour import FIELDS as MOTION_FIELDS
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.distribution import WindowFeatures, sample_windows
from talkingeyes.evaluation.measures.metric import HIGHER, LOWER, Metric, Sums, Totals

MAX_GROUPS = 1000
# Random splits of the reference into halves: the floor of metrics that compare with it.
SPLIT_HALF_REPEATS = 20
# Number of windows of each set that are compared pairwise, and of resamples of their sounds.
PAIRWISE_WINDOWS, PAIRWISE_DRAWS = 300, 200


@dataclass(frozen=True)
class SumLayout:
    """Position of each sum in the flat vector of a clip; the first entries count its motions with each field.

    A single number has an index, an array a slice (writing to an index is five times as fast).
    """

    slots: dict[str, int | slice]
    size: int

    @classmethod
    def of(cls, sizes: Iterable[tuple[str, int]]) -> SumLayout:
        """Layout of consecutive sums, given as (name, length)."""
        slots: dict[str, int | slice] = {}
        start = 0
        for name, size in sizes:
            assert name not in slots, name  # two extractors would add to one sum
            slots[name] = start if size == 1 else slice(start, start + size)
            start += size
        return cls(slots, start)

    def totals(self, flat: Float[ndarray, "D K"]) -> Totals:
        """Views of the flat totals by name."""
        return {name: flat[:, place] for name, place in self.slots.items()}


FIELDS = tuple(dict.fromkeys(field for extractor in EXTRACTORS for field in extractor.needs))
LAYOUT = SumLayout.of(
    [(f"motions with {field}", 1) for field in FIELDS]
    + [item for extractor in EXTRACTORS for item in extractor.sizes.items()]
)


def extract(motions: Sequence[Behaviour]) -> Float[ndarray, " K"]:
    """All sums over the motions of one sound, as a flat vector."""
    flat = np.zeros(LAYOUT.size)
    for extractor in EXTRACTORS:
        if extractor.together and motions and all(_has(motion, need) for motion in motions for need in extractor.needs):
            _add(flat, extractor.extract(motions))
    for motion in motions:
        has = {field: _has(motion, field) for field in FIELDS}
        flat[: len(FIELDS)] += list(has.values())
        for extractor in EXTRACTORS:
            if not extractor.together and all(has[field] for field in extractor.needs):
                _add(flat, extractor.extract(motion))
    return flat


def _has(motion: Behaviour, field: str) -> bool:
    """Whether a motion, and the one that it is compared with, have a field."""
    other = motion.reference if field in MOTION_FIELDS else None
    return motion.has(field) and (other is None or other.has(field))


def _add(flat: Float[ndarray, " K"], sums: Sums) -> None:
    for name, value in sums.items():
        flat[LAYOUT.slots[name]] += value


class Accumulator:
    """Sums of clips at one frame rate, in groups; clip n is added to group n modulo MAX_GROUPS."""

    def __init__(self, fps: float) -> None:
        self.fps, self.clips = fps, 0
        self.features: list[Float[ndarray, "W D"]] = []
        self._groups = np.zeros((MAX_GROUPS, LAYOUT.size))

    def add(self, flat: Float[ndarray, " K"], features: Float[ndarray, "W D"] | None = None) -> None:
        """Add one clip; the features of its windows are only kept for the first MAX_GROUPS clips."""
        self._groups[self.clips % MAX_GROUPS] += flat
        self.clips += 1
        if features is not None and len(self.features) < MAX_GROUPS:
            self.features.append(features)

    @property
    def groups(self) -> Float[ndarray, "G K"]:
        """The groups in use."""
        return self._groups[: min(self.clips, MAX_GROUPS)]

    def totals(self, bootstrap_weights: Float[ndarray, "D G"] | None = None) -> Totals:
        """Totals over all groups, or over each of D resamples of them."""
        groups = self.groups
        return LAYOUT.totals(
            groups.sum(axis=0, keepdims=True) if bootstrap_weights is None else bootstrap_weights @ groups
        )


def bootstrap_weights(count: int, settings: BootstrapSettings) -> Float[ndarray, "D G"]:
    """How often each of `count` groups occurs in each resample; the resamples are those of `bootstrap`."""
    resampled = resample_indices(count, settings)
    offset = resampled + count * np.arange(len(resampled))[:, None]
    return np.bincount(offset.ravel(), minlength=resampled.size).reshape(resampled.shape).astype(float)


@dataclass(frozen=True)
class MetricResult:
    """A metric of a set of motions and of the reference, and their difference; None where there is no value.

    `difference` is value less reference over the same resamples. For metrics that compare with the reference,
    `reference` is the comparison of two halves of the reference. `reason` says why a value is missing.
    """

    metric: Metric
    count: int
    value: Estimate | None
    reference: Estimate | None
    difference: Estimate | None
    reason: str = ""

    @property
    def worse(self) -> bool | None:
        """Whether the motions are worse than the reference by more than the interval; None where not compared."""
        if self.value is None or self.reference is None:
            return None
        direction = self.metric.direction
        if self.difference is None:
            return self.value.low > self.reference.high if direction == LOWER else self.value.high < self.reference.low
        if direction == LOWER:
            return self.difference.low > 0
        return self.difference.high < 0 if direction == HIGHER else not self.difference.low <= 0 <= self.difference.high


class Comparison:
    """Comparison of motions with a reference.

    `paired`: clip n of both is the same sound, so both use the same resamples.
    """

    def __init__(
        self, evaluated: Accumulator, reference: Accumulator, settings: BootstrapSettings, paired: bool
    ) -> None:
        self.evaluated, self.reference, self.settings, self.paired = evaluated, reference, settings, paired
        self.same_rate = evaluated.fps == reference.fps

    @cached_property
    def _resampled(self) -> Totals:
        return self.evaluated.totals(bootstrap_weights(len(self.evaluated.groups), self.settings))

    @cached_property
    def _reference_resampled(self) -> Totals:
        settings = self.settings if self.paired else self.settings.model_copy(update={"seed": self.settings.seed + 1})
        return self.reference.totals(bootstrap_weights(len(self.reference.groups), settings))

    @cached_property
    def _halves(self) -> tuple[Totals, Totals]:
        count = len(self.reference.groups)
        rng = np.random.default_rng([self.settings.seed, count])
        half = np.stack([rng.permutation(count) < count // 2 for _ in range(SPLIT_HALF_REPEATS)]).astype(float)
        return self.reference.totals(half), self.reference.totals(1 - half)

    @cached_property
    def _all(self) -> tuple[Totals, Totals]:
        return self.evaluated.totals(), self.reference.totals()

    def rows(self, metrics: Sequence[Metric] = METRICS) -> Iterator[MetricResult]:
        """One result for each metric."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter(
                "ignore", RuntimeWarning
            )  # quantiles of empty sets, where all resamples are undefined
            for metric in metrics:
                yield self._row(metric)

    def missing(self, metrics: Sequence[Metric] = METRICS) -> list[Metric]:
        """Metrics that are not compared because the motions have too few events, while the reference has enough.

        Metrics whose fields the motions lack are not included.
        """
        ours, theirs = self._all
        return [
            metric
            for metric in metrics
            if all(ours[f"motions with {field}"][0] for field in metric.extractor.needs)
            and ours[metric.count_key][0] < metric.min_count
            and not _lacking(metric, theirs, "the reference")
        ]

    def _row(self, metric: Metric) -> MetricResult:
        ours, theirs = self._all
        count = int(ours[metric.count_key][0])
        reason = _lacking(metric, ours, "the motions")
        if not metric.compute:
            reason = reason or _lacking(metric, theirs, "the reference")
            if not self.same_rate and metric.rate_dependent:
                reason = self._rates
        if reason:
            return MetricResult(metric, count, None, None, None, reason)
        if metric.pairwise:
            return self._pairwise(metric, count)
        return self._against(metric, count) if metric.compare else self._figure(metric, count)

    def _pairwise(self, metric: Metric, count: int) -> MetricResult:
        assert metric.pairwise is not None
        settings = self.settings.model_copy(update={"n_resamples": min(self.settings.n_resamples, PAIRWISE_DRAWS)})
        ours, theirs = self.evaluated.features, self.reference.features
        paired = self.paired and len(ours) == len(theirs)
        statistic = metric.pairwise(self._some(ours), self._some(theirs), paired)
        order = np.random.default_rng(self.settings.seed).permutation(len(theirs))
        halves = [[theirs[index] for index in half] for half in np.array_split(order, 2)]
        between = metric.pairwise(self._some(halves[0]), self._some(halves[1]), False)
        return MetricResult(
            metric,
            count,
            bootstrap(statistic, len(ours), settings),
            bootstrap(between, len(halves[1]), settings),
            None,
        )

    def _some(self, groups: Sequence[Float[ndarray, "_ D"]]) -> WindowFeatures:
        return sample_windows(groups, PAIRWISE_WINDOWS, self.settings.seed)

    @property
    def _rates(self) -> str:
        return f"not compared: {self.evaluated.fps:g} frames per second, reference {self.reference.fps:g}"

    def _against(self, metric: Metric, count: int) -> MetricResult:
        assert metric.compare is not None
        ours, theirs = self._all
        value = _estimate(metric.compare(ours, theirs), metric.compare(self._resampled, theirs), self.settings)
        between = metric.compare(*self._halves)
        floor = None
        if np.isfinite(between).any():
            floor = Estimate(float(np.nanmean(between)), *percentile_interval(between, self.settings))
        return MetricResult(metric, count, value, floor, None, "" if value else "undefined")

    def _figure(self, metric: Metric, count: int) -> MetricResult:
        assert metric.compute is not None
        ours, theirs = self._all
        resampled = metric.compute(self._resampled)
        value = _estimate(metric.compute(ours), resampled, self.settings)
        lacking = _lacking(metric, theirs, "the reference") or (
            self._rates if metric.rate_dependent and not self.same_rate else ""
        )
        if value is None or lacking:
            return MetricResult(metric, count, value, None, None, lacking or "undefined")
        reference_resampled = metric.compute(self._reference_resampled)
        own = metric.compute(theirs)
        reference = _estimate(own, reference_resampled, self.settings)
        difference = _estimate(metric.compute(ours) - own, resampled - reference_resampled, self.settings)
        return MetricResult(
            metric, count, value, reference, difference, "" if reference else "the reference has no value"
        )


def _lacking(metric: Metric, totals: Totals, whose: str) -> str:
    """Why there is no value, in words; empty if there is one."""
    missing = [field for field in metric.extractor.needs if not totals[f"motions with {field}"][0]]
    if missing:
        return f"needs {' and '.join(missing)}: missing in {whose}"
    count = int(totals[metric.count_key][0])
    return "" if count >= metric.min_count else f"needs {metric.min_count} {metric.count_unit}: {whose} have {count}"


def _estimate(
    value: Float[ndarray, " 1"], resampled: Float[ndarray, " D"], settings: BootstrapSettings
) -> Estimate | None:
    if not np.isfinite(value[0]) or not np.isfinite(resampled).any():
        return None
    return Estimate(float(value[0]), *percentile_interval(resampled, settings))
