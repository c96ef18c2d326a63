"""The benchmark: all measures, in the order of its table."""

from __future__ import annotations

from talkingeyes.evaluation.benchmark import eyes, features, lids, likeness, looking, movement, saccades, samples, sound
from talkingeyes.evaluation.benchmark.measure import Extractor, Metric

METRICS: tuple[Metric, ...] = (
    *saccades.METRICS,
    *looking.METRICS,
    *eyes.METRICS,
    *lids.METRICS,
    *movement.METRICS,
    *likeness.METRICS,
    *samples.METRICS,
    *features.METRICS,
    *sound.METRICS,
)
# Each once: several measures read one observer's sums.
EXTRACTORS: tuple[Extractor, ...] = tuple({id(each.extractor): each.extractor for each in METRICS}.values())
