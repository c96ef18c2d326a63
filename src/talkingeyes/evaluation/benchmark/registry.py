"""The benchmark: all measures, in the order of its table."""

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
# Each once: several measures read one observer's sums.
EXTRACTORS: tuple[Extractor, ...] = tuple({id(each.extractor): each.extractor for each in METRICS}.values())
