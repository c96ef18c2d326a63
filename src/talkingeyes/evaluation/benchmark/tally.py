"""The benchmark over many clips: sums in groups, resamples of the groups, a row a measure.

A clip here is a sound with all its motions (samples of a model, takes of the truth): the bootstrap draws sounds, never
samples. Beyond GROUPS clips several share a group, so memory does not grow with the corpus; the interval is then over
groups of clips, which is as wide.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.measure import LESS, MORE, Measure, Sums, Totals
from talkingeyes.evaluation.benchmark.registry import MEASURES, OBSERVERS
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, interval, resamples
from talkingeyes.evaluation.distribution.mmd import Drawn, draw

GROUPS = 1000
# Random halvings of the reference that measures of comparison are read beside.
HALVINGS = 20
# Windows that are compared pairwise, of either set, and resamples of their sounds.
PAIRWISE_WINDOWS, PAIRWISE_DRAWS = 300, 200


@dataclass(frozen=True)
class Layout:
    """Where each sum stands in the flat vector of a clip; first how many of its motions have each field.

    A single number stands at an index, several in a slice (an index is written five times as fast).
    """

    places: dict[str, int | slice]
    size: int

    @classmethod
    def of(cls, sizes: Iterable[tuple[str, int]]) -> Layout:
        """Sums of given lengths, one behind the other."""
        places: dict[str, int | slice] = {}
        start = 0
        for name, size in sizes:
            assert name not in places, name  # two observers would add to one sum
            places[name] = start if size == 1 else slice(start, start + size)
            start += size
        return cls(places, start)

    def totals(self, flat: Float[ndarray, "D K"]) -> Totals:
        """Named views of flat totals."""
        return {name: flat[:, place] for name, place in self.places.items()}


FIELDS = tuple(dict.fromkeys(field for observer in OBSERVERS for field in observer.needs))
LAYOUT = Layout.of(
    [(f"motions with {field}", 1) for field in FIELDS]
    + [item for observer in OBSERVERS for item in observer.sizes.items()]
)


def observe(motions: Sequence[Behaviour]) -> Float[ndarray, " K"]:
    """All sums over the motions of one sound."""
    flat = np.zeros(LAYOUT.size)
    for observer in OBSERVERS:
        if observer.together and motions and all(all(map(motion.has, observer.needs)) for motion in motions):
            _add(flat, observer.observe(motions))
    for motion in motions:
        has = {field: motion.has(field) for field in FIELDS}
        flat[: len(FIELDS)] += list(has.values())
        for observer in OBSERVERS:
            if not observer.together and all(has[field] for field in observer.needs):
                _add(flat, observer.observe(motion))
    return flat


def _add(flat: Float[ndarray, " K"], sums: Sums) -> None:
    for name, value in sums.items():
        flat[LAYOUT.places[name]] += value


class Tally:
    """Sums of clips at one frame rate, in groups; the n-th clip goes to group n modulo GROUPS."""

    def __init__(self, fps: float) -> None:
        self.fps, self.clips = fps, 0
        self.features: list[Float[ndarray, "W D"]] = []
        self._groups = np.zeros((GROUPS, LAYOUT.size))

    def add(self, flat: Float[ndarray, " K"], features: Float[ndarray, "W D"] | None = None) -> None:
        """Count one clip; features of its windows are kept of the first GROUPS clips."""
        self._groups[self.clips % GROUPS] += flat
        self.clips += 1
        if features is not None and len(self.features) < GROUPS:
            self.features.append(features)

    @property
    def groups(self) -> Float[ndarray, "G K"]:
        """The groups in use."""
        return self._groups[: min(self.clips, GROUPS)]

    def totals(self, weights: Float[ndarray, "D G"] | None = None) -> Totals:
        """Totals over all groups, or over each draw of them."""
        groups = self.groups
        return LAYOUT.totals(groups.sum(axis=0, keepdims=True) if weights is None else weights @ groups)


def weights(count: int, settings: BootstrapSettings) -> Float[ndarray, "D G"]:
    """How often each of `count` groups is drawn in each resample: those of `bootstrap`, counted."""
    drawn = resamples(count, settings)
    offset = drawn + count * np.arange(len(drawn))[:, None]
    return np.bincount(offset.ravel(), minlength=drawn.size).reshape(drawn.shape).astype(float)


@dataclass(frozen=True)
class Row:
    """A measure of a set of motions, of the reference, and how far they are apart; None where there is no figure.

    `difference` is value less reference over the same draws. For measures that compare with the reference,
    `reference` is the comparison of its own halves. `reason` says in words what keeps a figure from being there.
    """

    measure: Measure
    count: int
    value: Estimate | None
    reference: Estimate | None
    difference: Estimate | None
    reason: str = ""

    @property
    def apart(self) -> bool | None:
        """Whether the motions are worse than the reference by more than the interval; None where not compared."""
        if self.value is None or self.reference is None:
            return None
        direction = self.measure.direction
        if self.difference is None:
            return self.value.low > self.reference.high if direction == LESS else self.value.high < self.reference.low
        if direction == LESS:
            return self.difference.low > 0
        return self.difference.high < 0 if direction == MORE else not self.difference.low <= 0 <= self.difference.high


class Comparison:
    """A tally against the reference's. `paired`: the n-th clip of both is the same sound, so both draw the same."""

    def __init__(self, tally: Tally, reference: Tally, settings: BootstrapSettings, paired: bool) -> None:
        self.tally, self.reference, self.settings, self.paired = tally, reference, settings, paired
        self.same_rate = tally.fps == reference.fps

    @cached_property
    def _drawn(self) -> Totals:
        return self.tally.totals(weights(len(self.tally.groups), self.settings))

    @cached_property
    def _reference_drawn(self) -> Totals:
        settings = self.settings if self.paired else self.settings.model_copy(update={"seed": self.settings.seed + 1})
        return self.reference.totals(weights(len(self.reference.groups), settings))

    @cached_property
    def _halves(self) -> tuple[Totals, Totals]:
        count = len(self.reference.groups)
        random = np.random.default_rng([self.settings.seed, count])
        half = np.stack([random.permutation(count) < count // 2 for _ in range(HALVINGS)]).astype(float)
        return self.reference.totals(half), self.reference.totals(1 - half)

    @cached_property
    def _all(self) -> tuple[Totals, Totals]:
        return self.tally.totals(), self.reference.totals()

    def rows(self, measures: Sequence[Measure] = MEASURES) -> Iterator[Row]:
        """A row a measure."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", RuntimeWarning)  # quantiles of nothing, where every draw is undefined
            for measure in measures:
                yield self._row(measure)

    def missing(self, measures: Sequence[Measure] = MEASURES) -> list[Measure]:
        """Measures of what the reference does often enough and the motions, which could, do not: none is compared."""
        ours, theirs = self._all
        return [
            measure
            for measure in measures
            if all(ours[f"motions with {field}"][0] for field in measure.observer.needs)
            and ours[measure.of][0] < measure.least
            and not _lacking(measure, theirs, "the reference")
        ]

    def _row(self, measure: Measure) -> Row:
        ours, theirs = self._all
        count = int(ours[measure.of][0])
        reason = _lacking(measure, ours, "the motions")
        if not measure.figure:
            reason = reason or _lacking(measure, theirs, "the reference")
            if not self.same_rate and measure.rate_bound:
                reason = self._rates
        if reason:
            return Row(measure, count, None, None, None, reason)
        if measure.pairwise:
            return self._pairwise(measure, count)
        return self._against(measure, count) if measure.against else self._figure(measure, count)

    def _pairwise(self, measure: Measure, count: int) -> Row:
        assert measure.pairwise is not None
        settings = self.settings.model_copy(update={"draws": min(self.settings.draws, PAIRWISE_DRAWS)})
        ours, theirs = self.tally.features, self.reference.features
        paired = self.paired and len(ours) == len(theirs)
        statistic = measure.pairwise(self._some(ours), self._some(theirs), paired)
        order = np.random.default_rng(self.settings.seed).permutation(len(theirs))
        halves = [[theirs[index] for index in half] for half in np.array_split(order, 2)]
        between = measure.pairwise(self._some(halves[0]), self._some(halves[1]), False)
        return Row(
            measure,
            count,
            bootstrap(statistic, len(ours), settings),
            bootstrap(between, len(halves[1]), settings),
            None,
        )

    def _some(self, groups: Sequence[Float[ndarray, "W D"]]) -> Drawn:
        return draw(groups, PAIRWISE_WINDOWS, self.settings.seed)

    @property
    def _rates(self) -> str:
        return f"not compared: {self.tally.fps:g} frames a second, the reference {self.reference.fps:g}"

    def _against(self, measure: Measure, count: int) -> Row:
        assert measure.against is not None
        ours, theirs = self._all
        value = _estimate(measure.against(ours, theirs), measure.against(self._drawn, theirs), self.settings)
        between = measure.against(*self._halves)
        floor = None
        if np.isfinite(between).any():
            floor = Estimate(float(np.nanmean(between)), *interval(between, self.settings))
        return Row(measure, count, value, floor, None, "" if value else "undefined")

    def _figure(self, measure: Measure, count: int) -> Row:
        assert measure.figure is not None
        ours, theirs = self._all
        drawn = measure.figure(self._drawn)
        value = _estimate(measure.figure(ours), drawn, self.settings)
        lacking = _lacking(measure, theirs, "the reference") or (
            self._rates if measure.rate_bound and not self.same_rate else ""
        )
        if value is None or lacking:
            return Row(measure, count, value, None, None, lacking or "undefined")
        reference_drawn = measure.figure(self._reference_drawn)
        own = measure.figure(theirs)
        reference = _estimate(own, reference_drawn, self.settings)
        difference = _estimate(measure.figure(ours) - own, drawn - reference_drawn, self.settings)
        return Row(measure, count, value, reference, difference, "" if reference else "the reference has no figure")


def _lacking(measure: Measure, totals: Totals, whose: str) -> str:
    """Why there is no figure, in words; empty if there is one."""
    missing = [field for field in measure.observer.needs if not totals[f"motions with {field}"][0]]
    if missing:
        return f"needs {' and '.join(missing)}: {whose} without"
    count = int(totals[measure.of][0])
    return "" if count >= measure.least else f"needs {measure.least} {measure.counted}: {whose} with {count}"


def _estimate(value: Float[ndarray, " 1"], drawn: Float[ndarray, " D"], settings: BootstrapSettings) -> Estimate | None:
    if not np.isfinite(value[0]) or not np.isfinite(drawn).any():
        return None
    return Estimate(float(value[0]), *interval(drawn, settings))
