"""The benchmark: all measures, in the order of its table."""

from __future__ import annotations

from talkingeyes.evaluation.benchmark import eyes, features, lids, likeness, looking, movement, saccades, samples, sound
from talkingeyes.evaluation.benchmark.measure import Measure, Observer

MEASURES: tuple[Measure, ...] = (
    *saccades.MEASURES,
    *looking.MEASURES,
    *eyes.MEASURES,
    *lids.MEASURES,
    *movement.MEASURES,
    *likeness.MEASURES,
    *samples.MEASURES,
    *features.MEASURES,
    *sound.MEASURES,
)
# Each once: several measures read one observer's sums.
OBSERVERS: tuple[Observer, ...] = tuple({id(each.observer): each.observer for each in MEASURES}.values())
