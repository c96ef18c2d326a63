"""Input of the reference ranges: a clip with its annotation, and named arrays pooled over clips.

An extractor turns one clip into named arrays whose first axis counts events, frames or clips; pooling concatenates them
along it. Values are computed from the pool, since amplitudes, dwell times and intervals need medians and fits, for
which sums are not sufficient. Values that the gaze benchmark also has are computed from its sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Events, Motion
from talkingeyes.evaluation.detectors.behaviour import Behaviour

# Arrays by name, of one clip or concatenated over many clips.
PooledArrays = Mapping[str, ndarray]
# Shorter gaps in speech do not end an utterance; long utterances are those that need planning ahead.
UTTERANCE_GAP_S, MIN_LONG_UTTERANCE_S = 0.5, 2.0


@dataclass(frozen=True)
class FrameProsody:
    """Prosody at motion frames: level and F0 (NaN where unvoiced)."""

    energy_dbfs: Float[ndarray, " T"]
    f0_hz: Float[ndarray, " T"]


@dataclass(frozen=True)
class ClipData:
    """One clip. `motion`, `annotation`, `frame_prosody` and `events` are None where unknown.

    `axis_divergence_rad` is the divergence of the optical axes relative to the lines of sight (left less right yaw:
    twice kappa), since `gaze` is the optical axis; 0 where `gaze` is the line of sight.
    """

    speaker: str
    behaviour: Behaviour
    motion: Motion | None = None
    annotation: Annotation | None = None
    frame_prosody: FrameProsody | None = None
    events: Events | None = None
    axis_divergence_rad: float = 0.0


@dataclass(frozen=True)
class Measurement:
    """A value with the number of events or frames behind it; without a value (None), `reason` says why."""

    value: float | None
    count: int
    count_unit: str
    reason: str = ""


def measurement(value: float, count: int, count_unit: str, min_count: int = 1) -> Measurement:
    """Measurement of `value`; without a value if `count` is below `min_count` or `value` is not finite."""
    if count < min_count:
        return Measurement(None, count, count_unit, f"too few {count_unit}: got {count}, needs {min_count}")
    if not np.isfinite(value):
        return Measurement(None, count, count_unit, "undefined")
    return Measurement(float(value), count, count_unit)


def measure_values(
    values: ndarray, statistic: Callable[[ndarray], float], count_unit: str, min_count: int = 1
) -> Measurement:
    """Measurement of a statistic of N values; without a value if N is below `min_count`."""
    return measurement(float(statistic(values)) if len(values) else np.nan, len(values), count_unit, min_count)


def no_measurement(reason: str) -> Measurement:
    """Measurement without a value, with the reason."""
    return Measurement(None, 0, "", reason)


def join_pools(pools: Iterable[PooledArrays]) -> dict[str, ndarray]:
    """Concatenate the arrays of many clips."""
    found: dict[str, list[ndarray]] = {}
    for pool in pools:
        for name, array in pool.items():
            found.setdefault(name, []).append(array)
    return {name: np.concatenate(arrays) for name, arrays in found.items()}


def utterances(annotation: Annotation) -> list[Span]:
    """Speaking spans, merged across gaps shorter than UTTERANCE_GAP_S."""
    found: list[Span] = []
    for span in annotation.speaking:
        if found and span.start_s - found[-1].end_s < UTTERANCE_GAP_S:
            found[-1] = Span(found[-1].start_s, span.end_s)
        else:
            found.append(span)
    return found


def in_spans(spans: Sequence[Span], behaviour: Behaviour) -> Bool[ndarray, " T"]:
    """Mask of the frames inside the spans."""
    inside = np.zeros(len(behaviour), bool)
    for span in spans:
        inside[max(0, round(span.start_s * behaviour.fps)) : max(0, round(span.end_s * behaviour.fps))] = True
    return inside


def speaking_turns(annotation: Annotation) -> list[Span]:
    """Turns from first to last word, including pauses; a turn ends where the person listens."""
    found: list[Span] = []
    for span in annotation.speaking:
        if found and not any(
            found[-1].end_s < each.end_s and each.start_s < span.start_s for each in annotation.listening
        ):
            found[-1] = Span(found[-1].start_s, span.end_s)
        else:
            found.append(span)
    return found
