"""The benchmark: all measures, in the order of its table."""

from __future__ import annotations

from talkingeyes.metrics.benchmark import eyes, lids, likeness, looking, movement, saccades
from talkingeyes.metrics.benchmark.measure import Measure, Observer

MEASURES: tuple[Measure, ...] = (
    *saccades.MEASURES,
    *looking.MEASURES,
    *eyes.MEASURES,
    *lids.MEASURES,
    *movement.MEASURES,
    *likeness.MEASURES,
)
# Each once: several measures read one observer's sums.
OBSERVERS: tuple[Observer, ...] = tuple({id(each.observer): each.observer for each in MEASURES}.values())
