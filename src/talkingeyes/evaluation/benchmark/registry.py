"""All metrics of the benchmark, in the order of its table."""

from __future__ import annotations

from talkingeyes.evaluation.benchmark import (
    blinks,
    corr,
    eye_head,
    features,
    movement,
    partner_gaze,
    reference_correlation,
    saccades,
    samples,
)
from talkingeyes.evaluation.benchmark.metric import Extractor, Metric

METRICS: tuple[Metric, ...] = (
    *saccades.METRICS,
    *partner_gaze.METRICS,
    *eye_head.METRICS,
    *blinks.METRICS,
    *movement.METRICS,
    *reference_correlation.METRICS,
    *samples.METRICS,
    *features.METRICS,
    *corr.METRICS,
)
# Without duplicates: several metrics use the sums of one extractor.
EXTRACTORS: tuple[Extractor, ...] = tuple({id(each.extractor): each.extractor for each in METRICS}.values())
