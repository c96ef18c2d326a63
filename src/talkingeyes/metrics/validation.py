"""Which measure notices which fault: the matrix of measures against corrupted truth.

The reference is one true take of every sound, what is judged another take of the same sounds, as it is and with each
fault. A measure catches a fault when it tells it from the reference by more than its bootstrap interval, in its own
direction, and farther than it tells true from true. The effect is the distance in intervals: 1 is the edge of the
interval, below 1 nothing is caught. One in twenty true takes is told apart by chance: that is what the interval means.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from talkingeyes.metrics.benchmark.behaviour import Behaviour
from talkingeyes.metrics.benchmark.measure import LESS, MORE, Measure
from talkingeyes.metrics.benchmark.registry import MEASURES
from talkingeyes.metrics.benchmark.tally import Comparison, Row, Tally, observe
from talkingeyes.metrics.bootstrap import BootstrapSettings, Estimate
from talkingeyes.metrics.corruptions import CORRUPTIONS, NOTHING, Corruption, corrupted


@dataclass(frozen=True)
class Takes:
    """Two true takes of the same sounds: the second one knows the first as its reference."""

    reference: Sequence[Behaviour]
    other: Sequence[Behaviour]
    speakers: Sequence[str]


@dataclass(frozen=True)
class Cell:
    """A measure of one fault. `effect` in intervals; NaN where there is no figure any more, which is told too."""

    value: float
    effect: float
    true_effect: float

    @property
    def caught(self) -> bool:
        """Whether the fault is told from the truth."""
        return bool(np.isnan(self.effect) or (self.effect > 1 and self.effect > self.true_effect))


# Measure to corruption to cell, in the order of the registry.
Matrix = Mapping[str, Mapping[str, Cell]]


def matrix(
    takes: Takes,
    settings: BootstrapSettings,
    strength: float = 1.0,
    corruptions: Sequence[Corruption] = CORRUPTIONS,
    seed: int = 0,
) -> Matrix:
    """All measures of the registry against all corruptions; those that the takes do not allow are left out."""
    fps = takes.reference[0].fps
    reference = tally(takes.reference, fps)
    rows = {}
    for corruption in (NOTHING, *corruptions):
        wrong = corrupted(takes.other, takes.speakers, corruption, strength, seed)
        rows[corruption.name] = list(Comparison(tally(wrong, fps), reference, settings, paired=True).rows(MEASURES))
    found = {}
    for index, true in enumerate(rows[NOTHING.name]):
        if true.value is not None and true.reference is not None:
            of_measure = {name: _cell(each[index], true) for name, each in rows.items()}
            found[true.measure.name] = of_measure
    return found


def tally(motions: Iterable[Behaviour], fps: float) -> Tally:
    """The sums of all motions, a sound each."""
    found = Tally(fps)
    for motion in motions:
        found.add(observe([motion]))
    return found


def catches(of_measure: Mapping[str, Cell]) -> list[str]:
    """The corruptions that a measure catches."""
    return [name for name, cell in of_measure.items() if name != NOTHING.name and cell.caught]


def _cell(row: Row, true: Row) -> Cell:
    effect = float("nan") if row.value is None or row.reference is None else _effect(row)
    return Cell(float("nan") if row.value is None else row.value.value, effect, _effect(true))


def _effect(row: Row) -> float:
    """Distance from the reference in the measure's own direction, over the half of its interval on that side."""
    assert row.value is not None
    assert row.reference is not None
    if row.difference is not None:
        return _signed(row.difference, row.measure)
    apart = row.value.value - row.reference.value
    if row.measure.direction == LESS:
        return _over(apart, (row.value.value - row.value.low) + (row.reference.high - row.reference.value))
    return _over(-apart, (row.value.high - row.value.value) + (row.reference.value - row.reference.low))


def _signed(difference: Estimate, measure: Measure) -> float:
    worse = difference.value
    if measure.direction == MORE or (measure.direction != LESS and worse < 0):
        return _over(-worse, difference.high - worse)
    return _over(worse, worse - difference.low)


def _over(distance: float, half: float) -> float:
    if distance == 0:
        return 0.0
    return distance / half if half > 0 else float("inf") if distance > 0 else float("-inf")
