"""What the facts look at: one clip with what is known of it, and rows of numbers that pool over clips.

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
from talkingeyes.evaluation.benchmark import eyes, lids, looking, movement, saccades
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.table import BY_NAME

# What one clip has, or many clips joined.
Pool = Mapping[str, ndarray]
# A gap in speech shorter than this does not end an utterance; an utterance this long is one that plans ahead.
UTTERANCE_GAP_S, LONG_UTTERANCE_S = 0.5, 2.0
OBSERVERS = (
    saccades.OBSERVER,
    looking.STATES,
    looking.CURVES,
    eyes.PAIR,
    eyes.COUNTER,
    movement.EYE,
    movement.SPACE,
    movement.HEAD,
    movement.SPEAKING,
    lids.BLINKS,
)


@dataclass(frozen=True)
class Sounding:
    """Prosody at motion frames: level, and F0 (NaN where unvoiced)."""

    energy_dbfs: Float[ndarray, " T"]
    f0_hz: Float[ndarray, " T"]


@dataclass(frozen=True)
class Seen:
    """One clip. `motion`, `annotation`, `sounding` and `events` are None where nobody knows them.

    `squint_rad`: how far the optical axes, which `gaze` is, part from the lines of sight of this person (left less
    right yaw: twice kappa); 0 where gaze is the line of sight.
    """

    speaker: str
    sound: str
    behaviour: Behaviour
    motion: Motion | None = None
    annotation: Annotation | None = None
    sounding: Sounding | None = None
    events: Events | None = None
    squint_rad: float = 0.0


@dataclass(frozen=True)
class Measured:
    """A figure and how many of what it is made of; None where there is none, and why."""

    value: float | None
    count: int
    counted: str
    reason: str = ""


def measured(value: float, count: int, counted: str, least: int = 1) -> Measured:
    """A figure of `count` things, if they are enough and it is a number."""
    if count < least:
        return Measured(None, count, counted, f"too few {counted}: {count}, {least} are needed")
    if not np.isfinite(value):
        return Measured(None, count, counted, "undefined")
    return Measured(float(value), count, counted)


def missing(reason: str) -> Measured:
    """No figure, and why."""
    return Measured(None, 0, "", reason)


def joined(pools: Iterable[Pool]) -> dict[str, ndarray]:
    """Many clips as one."""
    found: dict[str, list[ndarray]] = {}
    for pool in pools:
        for name, array in pool.items():
            found.setdefault(name, []).append(array)
    return {name: np.concatenate(arrays) for name, arrays in found.items()}


def sums(behaviour: Behaviour) -> dict[str, ndarray]:
    """The benchmark's sums of one clip, each with a first axis of 1."""
    found: dict[str, ndarray] = {}
    for observer in OBSERVERS:
        if all(behaviour.has(field) for field in observer.needs):
            found |= {name: np.asarray(value, float)[None] for name, value in observer.observe(behaviour).items()}
    return found


def benchmark(pool: Pool, name: str) -> Measured:
    """A figure of the gaze benchmark, read from the sums in the pool."""
    measure = BY_NAME[name]
    assert measure.figure is not None
    if measure.of not in pool:
        return missing(f"no {' and '.join(measure.observer.needs)}")
    totals = {key: pool[key].sum(axis=0, keepdims=True) for key in measure.observer.sizes}
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(measure.figure(totals)[0])
    return measured(value, int(totals[measure.of][0]), measure.counted, measure.least)


def utterances(annotation: Annotation) -> list[Span]:
    """Speech without its short gaps."""
    found: list[Span] = []
    for span in annotation.speaking:
        if found and span.start_s - found[-1].end_s < UTTERANCE_GAP_S:
            found[-1] = Span(found[-1].start_s, span.end_s)
        else:
            found.append(span)
    return found


def within(spans: Sequence[Span], behaviour: Behaviour) -> Bool[ndarray, " T"]:
    """Frames inside the spans."""
    inside = np.zeros(len(behaviour), bool)
    for span in spans:
        inside[max(0, round(span.start_s * behaviour.fps)) : max(0, round(span.end_s * behaviour.fps))] = True
    return inside


def talking(annotation: Annotation) -> list[Span]:
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
