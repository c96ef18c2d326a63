"""All metrics of the benchmark, in the order of its table; the version of the benchmark, and the JSON Schema of
benchmark.json.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from talkingeyes.evaluation.bootstrap import Estimate
from talkingeyes.evaluation.measures import blinks, corr, eye_head, features, movement, partner_gaze, saccades, samples
from talkingeyes.evaluation.measures.metric import Direction, Extractor, Metric

METRICS: tuple[Metric, ...] = (
    *saccades.METRICS,
    *partner_gaze.METRICS,
    *eye_head.METRICS,
    *blinks.METRICS,
    *movement.METRICS,
    *samples.REFERENCE_CORRELATIONS,
    *samples.METRICS,
    *features.METRICS,
    *corr.METRICS,
)
# Without duplicates: several metrics use the sums of one extractor.
EXTRACTORS: tuple[Extractor, ...] = tuple({id(each.extractor): each.extractor for each in METRICS}.values())


SCHEMA: Literal["talkingeyes.benchmark/3"] = "talkingeyes.benchmark/3"
# Major: the same motions can give another value of a metric, or a metric is removed. Minor: a metric is added.
VERSION = "1.0"


class Document(BaseModel):
    """Base of the parts of benchmark.json."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class MetricEntry(Document):
    """A metric of the motions and of the reference, each with its interval; null where there is no value."""

    count: int = Field(description="Number of events, frames or clips behind the value.")
    count_unit: str = Field(description="What is counted.")
    value: Estimate | None
    reference: Estimate | None = Field(description="Of the true motion; for a metric that compares, of its halves.")
    difference: Estimate | None = Field(description="Value less reference, over the same resamples.")
    worse: bool | None = Field(description="Whether worse than the reference by more than the interval.")
    reason: str = Field(description="Why there is no value; else empty.")
    random: Estimate | None = Field(None, description="Of the true motion of other speakers under other sounds.")
    random_worse: bool | None = Field(None, description="Whether `random` is worse than the reference.")
    unit: str
    direction: Direction = Field(description="What is better: closer to the reference, lower, or higher.")


class BenchmarkDocument(Document):
    """The gaze benchmark of a set of motions (docs/benchmark.md)."""

    schema_: Literal["talkingeyes.benchmark/3"] = Field(alias="schema", description="Form of this file.")
    benchmark_version: str = Field(
        pattern=r"^\d+\.\d+$", description="Values compare only under one first number (docs/evaluate.md)."
    )
    sounds: int
    fps: float | None = Field(None, description="Frames per second of the motions.")
    reference_fps: float | None = None
    same_sounds: bool | None = Field(None, description="Whether the reference is of the same sounds.")
    notes: list[str] | None = Field(None, description="Files that were left out, and why.")
    metrics: dict[str, MetricEntry]


def json_schema() -> dict[str, Any]:
    """JSON Schema of benchmark.json."""
    return BenchmarkDocument.model_json_schema()
