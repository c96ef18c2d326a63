"""Blinks: rate, duration, kinematics, and coupling to phrase ends and gaze shifts.

Sources: Doughty 2001, Bentivoglio 1997 (rates), VanderWerf 2003 and Sforza 2008 (kinematics, measured at the highest
frame rate), Nakano & Kitazawa 2010 (ends of phrases), Evinger 1994 (gaze shifts).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy import stats

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, PooledArrays, in_spans, measurement
from talkingeyes.physiology import blinks as blink_model

NEAR_END_S = 0.5
SHIFT_DEG = (20.0, 30.0)
AT_SHIFT_S = (-0.1, 0.2)
MIN_SPEAKER_S = 60.0
SHUT_TOLERANCE = 0.02  # of closure, below the largest: counts as shut
STILL_PER_S = 0.15  # closure per second; slower lids are at rest


def extract(speaker: str, behaviour: Behaviour, annotation: Annotation | None) -> PooledArrays:
    """Number of blinks, blinks near phrase ends and within phrases, and blinks at large gaze shifts."""
    found = {
        "blink.speaker": np.array([speaker]),
        **extract_gaze_shifts(behaviour),
    }
    if annotation is not None and annotation.speaking:
        found["phrase.counts"] = _at_ends(behaviour, annotation)
    return found


def _at_ends(behaviour: Behaviour, annotation: Annotation) -> Float[ndarray, "1 4"]:
    """Blinks and seconds within half a second of a phrase end; blinks and seconds elsewhere within phrases."""
    near = np.zeros(len(behaviour), bool)
    for span in annotation.speaking:
        low, high = (max(0, round((span.end_s + edge) * behaviour.fps)) for edge in (-NEAR_END_S, NEAR_END_S))
        near[low:high] = True
    amid = in_spans(annotation.speaking, behaviour) & ~near
    frame = np.clip(np.round(behaviour.blinks.onset_s * behaviour.fps).astype(int), 0, len(near) - 1)
    fps = behaviour.fps
    return np.array([[near[frame].sum(), near.sum() / fps, amid[frame].sum(), amid.sum() / fps]], float)


def extract_gaze_shifts(behaviour: Behaviour) -> dict[str, ndarray]:
    """Number of blinks and seconds; expected and observed blinks at each gaze shift of 20 to 30 degrees."""
    shifts, onsets = behaviour.saccades, behaviour.blinks.onset_s
    size = shifts.amplitude_deg
    large = (size >= SHIFT_DEG[0]) & (size < SHIFT_DEG[1])
    expected = np.array([blink_model.evoked_blink_probability(float(np.radians(each))) for each in size[large]])
    late = onsets[None] - shifts.onset_s[large][:, None]
    return {
        "blink.per_s": np.array([[len(onsets), behaviour.valid.sum() / behaviour.fps]]),
        "evoked.expected": expected,
        "evoked.blinked": ((late >= AT_SHIFT_S[0]) & (late <= AT_SHIFT_S[1])).any(axis=1).astype(float),
    }


def extract_kinematics(behaviour: Behaviour) -> PooledArrays:
    """Kinematics of each blink at a high frame rate: duration, closing and opening time, and peak speeds of both."""
    found = behaviour.blinks
    assert behaviour.lid is not None
    lid, fps = behaviour.lid.mean(axis=1), behaviour.fps
    speed = np.gradient(lid) * fps
    rows = []
    for onset, peak, offset in zip(found.onset_s, found.peak_s, found.offset_s, strict=True):
        first, middle, last = (round(each * fps) for each in (onset, peak, offset))
        first, last = _edges(lid, speed, first, last)
        if 0 < first < middle < last < len(lid) - 1:
            closed = np.flatnonzero(lid[first : last + 1] >= lid[middle] - SHUT_TOLERANCE) + first
            down, up = (closed[0] - first) / fps, (last - closed[-1]) / fps
            rows.append(((last - first) / fps, down, up, speed[first:middle].max(), -speed[middle:last].min()))
    columns = np.array(rows).reshape(-1, 5).T
    names = ("length_s", "down_s", "up_s", "closing_per_s", "opening_per_s")
    return {f"course.{name}": column for name, column in zip(names, columns, strict=True)}


def _edges(lid: Float[ndarray, " T"], speed_per_s: Float[ndarray, " T"], first: int, last: int) -> tuple[int, int]:
    """Extend the detected onset and offset (a tenth of the depth) outwards to where the lid is at rest."""
    while first > 0 and speed_per_s[first] > STILL_PER_S and lid[first - 1] < lid[first]:
        first -= 1
    while last < len(lid) - 1 and -speed_per_s[last] > STILL_PER_S and lid[last + 1] < lid[last]:
        last += 1
    return first, last


def rates_per_min(pool: PooledArrays) -> Float[ndarray, " P"]:
    """Blinks per minute of each speaker with at least a minute."""
    speakers, counts = pool["blink.speaker"], pool["blink.per_s"]
    totals = [counts[speakers == speaker].sum(axis=0) for speaker in np.unique(speakers)]
    return np.array([60 * blinks / seconds for blinks, seconds in totals if seconds >= MIN_SPEAKER_S])


def mean_rate(pool: PooledArrays) -> dict[str, Measurement]:
    """Mean of the rates over speakers, and their 2.5 % and 97.5 % quantiles."""
    rates = rates_per_min(pool)
    if len(rates) < 5:
        few = measurement(np.nan, len(rates), "speakers with a minute", 5)
        return dict.fromkeys(("blink_rate", "blink_low", "blink_high"), few)
    low, high = np.quantile(rates, [0.025, 0.975])
    values = {"blink_rate": float(rates.mean()), "blink_low": float(low), "blink_high": float(high)}
    return {name: measurement(value, len(rates), "speakers") for name, value in values.items()}


def log_normal_p(rates: Sequence[float]) -> Measurement:
    """p value of the hypothesis that the logarithms are normal (Kolmogorov-Smirnov, with their sample mean and SD)."""
    logs = np.log(rates)
    p = stats.kstest((logs - logs.mean()) / logs.std(ddof=1), "norm").pvalue
    return measurement(float(p), len(logs), "sampled speakers", 100)


def phrase_end_ratio(pool: PooledArrays) -> Measurement:
    """Blink rate within half a second of a phrase end divided by the rate elsewhere within phrases."""
    if "phrase.counts" not in pool:
        return measurement(np.nan, 0, "blinks", 50)
    near, near_s, amid, amid_s = pool["phrase.counts"].sum(axis=0)
    value = (near / near_s) / (amid / amid_s) if near_s and amid and amid_s else np.nan
    return measurement(value, int(near + amid), "blinks", 50)


def gaze_evoked(pool: PooledArrays) -> Measurement:
    """Probability of a blink at gaze shifts of 20 to 30 degrees less that of the model, corrected for chance."""
    expected, blinked = pool["evoked.expected"], pool["evoked.blinked"]
    blinks, seconds = pool["blink.per_s"].sum(axis=0)
    by_chance = 1 - np.exp(-blinks / max(seconds, 1e-9) * (AT_SHIFT_S[1] - AT_SHIFT_S[0]))
    seen = (blinked.mean() - by_chance) / (1 - by_chance) if len(blinked) else np.nan
    return measurement(float(seen - expected.mean()) if len(blinked) else np.nan, len(blinked), "shifts", 30)


def blink_kinematics(pool: PooledArrays) -> dict[str, Measurement]:
    """Median durations in milliseconds, and median ratio of peak closing to peak opening speed (`blink_faster`)."""
    length = pool["course.length_s"]
    values = {
        f"blink_{name}": 1000 * float(np.median(pool[f"course.{name}_s"])) if len(length) else np.nan
        for name in ("length", "down", "up")
    }
    faster = pool["course.closing_per_s"] / np.maximum(pool["course.opening_per_s"], 1e-9)
    values["blink_faster"] = float(np.median(faster)) if len(faster) else np.nan
    return {name: measurement(value, len(length), "blinks", 30) for name, value in values.items()}
