"""What the reference ranges are measured on: a clip with its annotation, and rows of numbers that pool over clips.

An observer turns one clip into named arrays whose first axis counts events, frames or the clip itself; pooled over
clips they are joined along it. Figures are read off the pool (amplitudes, dwells, intervals need medians and fits, for
which sums are not enough). Figures that the gaze benchmark already has are read from its own sums.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Events, Motion
from talkingeyes.evaluation.benchmark import blinks, eye_head, movement, partner_gaze, saccades
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.table import METRICS_BY_NAME

# What one clip has, or many clips joined.
PooledArrays = Mapping[str, ndarray]
# A gap in speech shorter than this does not end an utterance; an utterance this long is one that plans ahead.
UTTERANCE_GAP_S, MIN_LONG_UTTERANCE_S = 0.5, 2.0
EXTRACTORS = (
    saccades.OBSERVER,
    partner_gaze.STATES,
    partner_gaze.CURVES,
    eye_head.BINOCULAR,
    eye_head.EYE_HEAD,
    movement.EYE,
    movement.SPACE,
    movement.HEAD,
    movement.SPEAKING,
    blinks.BLINKS,
)


@dataclass(frozen=True)
class FrameProsody:
    """Prosody at motion frames: level, and F0 (NaN where unvoiced)."""

    energy_dbfs: Float[ndarray, " T"]
    f0_hz: Float[ndarray, " T"]


@dataclass(frozen=True)
class ClipData:
    """One clip. `motion`, `annotation`, `frame_prosody` and `events` are None where nobody knows them.

    `axis_divergence_rad`: how far the optical axes, which `gaze` is, part from the lines of sight of this person (left
    less right yaw: twice kappa); 0 where gaze is the line of sight.
    """

    speaker: str
    sound: str
    behaviour: Behaviour
    motion: Motion | None = None
    annotation: Annotation | None = None
    frame_prosody: FrameProsody | None = None
    events: Events | None = None
    axis_divergence_rad: float = 0.0


@dataclass(frozen=True)
class Measurement:
    """A figure and how many of what it is made of; None where there is none, and why."""

    value: float | None
    count: int
    count_unit: str
    reason: str = ""


def measurement(value: float, count: int, count_unit: str, min_count: int = 1) -> Measurement:
    """A figure of `count` things, if they are enough and it is a number."""
    if count < min_count:
        return Measurement(None, count, count_unit, f"too few {count_unit}: {count}, {min_count} are needed")
    if not np.isfinite(value):
        return Measurement(None, count, count_unit, "undefined")
    return Measurement(float(value), count, count_unit)


def no_measurement(reason: str) -> Measurement:
    """No figure, and why."""
    return Measurement(None, 0, "", reason)


def join_pools(pools: Iterable[PooledArrays]) -> dict[str, ndarray]:
    """Many clips as one."""
    found: dict[str, list[ndarray]] = {}
    for pool in pools:
        for name, array in pool.items():
            found.setdefault(name, []).append(array)
    return {name: np.concatenate(arrays) for name, arrays in found.items()}


def benchmark_sums(behaviour: Behaviour) -> dict[str, ndarray]:
    """The benchmark's sums of one clip, each with a first axis of 1."""
    found: dict[str, ndarray] = {}
    for extractor in EXTRACTORS:
        if all(behaviour.has(field) for field in extractor.needs):
            found |= {name: np.asarray(value, float)[None] for name, value in extractor.extract(behaviour).items()}
    return found


def benchmark_metric(pool: PooledArrays, name: str) -> Measurement:
    """A figure of the gaze benchmark, read from the sums in the pool."""
    metric = METRICS_BY_NAME[name]
    assert metric.compute is not None
    if metric.count_key not in pool:
        return no_measurement(f"no {' and '.join(metric.extractor.needs)}")
    totals = {key: pool[key].sum(axis=0, keepdims=True) for key in metric.extractor.sizes}
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(metric.compute(totals)[0])
    return measurement(value, int(totals[metric.count_key][0]), metric.count_unit, metric.min_count)


def utterances(annotation: Annotation) -> list[Span]:
    """Speech without its short gaps."""
    found: list[Span] = []
    for span in annotation.speaking:
        if found and span.start_s - found[-1].end_s < UTTERANCE_GAP_S:
            found[-1] = Span(found[-1].start_s, span.end_s)
        else:
            found.append(span)
    return found


def in_spans(spans: Sequence[Span], behaviour: Behaviour) -> Bool[ndarray, " T"]:
    """Frames inside the spans."""
    inside = np.zeros(len(behaviour), bool)
    for span in spans:
        inside[max(0, round(span.start_s * behaviour.fps)) : max(0, round(span.end_s * behaviour.fps))] = True
    return inside


def speaking_turns(annotation: Annotation) -> list[Span]:
    """From the first word of a turn to its last, pauses inside it included; listening ends a turn."""
    found: list[Span] = []
    for span in annotation.speaking:
        if found and not any(
            found[-1].end_s < each.end_s and each.start_s < span.start_s for each in annotation.listening
        ):
            found[-1] = Span(found[-1].start_s, span.end_s)
        else:
            found.append(span)
    return found
