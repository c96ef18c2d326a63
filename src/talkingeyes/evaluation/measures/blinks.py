"""Blinks: rate, duration, depth, regularity, kinematics, and coupling to gaze shifts and phrase ends.

Blinks accompany gaze shifts (Evinger et al. 1994) and follow the ends of phrases (Nakano & Kitazawa 2010). A coupling
is the blink rate inside a window divided by the rate outside it, so that a higher blink rate alone does not raise it.

The reference ranges have rates by speaker, kinematics at the highest frame rate, and blinks at gaze shifts against the
model of them. Sources: Doughty 2001, Bentivoglio 1997 (rates), VanderWerf 2003 and Sforza 2008 (kinematics), Nakano &
Kitazawa 2010 (ends of phrases), Evinger 1994 (gaze shifts).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide, variation
from talkingeyes.evaluation.measures.pooled import Measurement, PooledArrays, in_spans, measurement
from talkingeyes.physiology import blinks as blink_model

DURATION_BINS_S = Bins(0.0, 0.8, 80)
MIN_GAZE_SHIFT_DEG, SHIFT_S = 8.0, (-0.15, 0.25)
PHRASE_END_S = (-0.1, 0.5)


def extract(behaviour: Behaviour) -> Sums:
    """Number, duration and depth of blinks, and the intervals between them."""
    blinks = behaviour.blinks
    interval = np.diff(blinks.onset_s)
    return {
        "blink.blinks": len(blinks),
        "blink.seconds": behaviour.valid.sum() / behaviour.fps,
        "blink.depth": blinks.depth.sum(),
        "blink.intervals": len(interval),
        "blink.interval_s": interval.sum(),
        "blink.interval_s2": np.square(interval).sum(),
        "blink.length": DURATION_BINS_S(blinks.duration_s),
    }


def extract_gaze_shift_blinks(behaviour: Behaviour) -> Sums:
    """Blinks that start near the onset of a large gaze shift, and the frames near one."""
    shifts = behaviour.saccades
    return _coupled(behaviour, "shift", shifts.onset_s[shifts.amplitude_deg >= MIN_GAZE_SHIFT_DEG], SHIFT_S)


def extract_phrase_end_blinks(behaviour: Behaviour) -> Sums:
    """Blinks that start near the end of a speaking span, and the frames near one."""
    assert behaviour.annotation is not None
    ends = np.array([span.end_s for span in behaviour.annotation.speaking])
    return _coupled(behaviour, "phrase", ends, PHRASE_END_S)


def _coupled(behaviour: Behaviour, name: str, events_s: Float[ndarray, " N"], window_s: tuple[float, float]) -> Sums:
    inside = np.zeros(len(behaviour), bool)
    for event in events_s:
        low, high = (max(0, round((event + edge) * behaviour.fps)) for edge in window_s)
        inside[low:high] = True
    frame = np.clip(np.round(behaviour.blinks.onset_s * behaviour.fps).astype(int), 0, len(behaviour) - 1)
    return {
        f"{name}.blinks": len(frame),
        f"{name}.blinks_inside": inside[frame].sum(),
        f"{name}.frames": len(inside),
        f"{name}.frames_inside": inside.sum(),
    }


BLINKS = Extractor(extract, ("lid",))
SHIFTS = Extractor(extract_gaze_shift_blinks, ("lid", "head", "gaze"))
PHRASES = Extractor(extract_phrase_end_blinks, ("lid", "annotation"))


def _coupling(totals: Totals, name: str) -> Float[ndarray, " D"]:
    inside, frames_inside = totals[f"{name}.blinks_inside"], totals[f"{name}.frames_inside"]
    outside = safe_divide(totals[f"{name}.blinks"] - inside, totals[f"{name}.frames"] - frames_inside)
    return safe_divide(safe_divide(inside, frames_inside), np.nan_to_num(outside))


_blink = partial(Metric, extractor=BLINKS, count_key="blink.blinks")

METRICS = (
    _blink(
        "blinks/rate",
        "blink rate",
        "1/min",
        "number of blinks / minutes of valid frames",
        compute=ratio("blink.blinks", "blink.seconds", 60.0),
        min_count=20,
        source="Bentivoglio et al. 1997; Doughty 2001",
        caveat="people differ by a factor of eight: a narrow interval needs many speakers, not many minutes",
    ),
    _blink(
        "blinks/duration_median",
        "median blink duration",
        "s",
        "median time between the lids leaving and regaining their resting opening",
        compute=lambda totals: DURATION_BINS_S.quantile(totals["blink.length"], 0.5),
        min_count=30,
        rate_dependent=True,
        source="VanderWerf et al. 2003",
        caveat="the fixed window of the paper (0.2 s) has no spread; tracking loses the slow end of blinks",
    ),
    _blink(
        "blinks/duration_distance",
        "blink durations, Wasserstein",
        "SD of truth",
        "area between the distribution functions of duration / SD of the reference's",
        compare=lambda totals, other: DURATION_BINS_S.distance(totals["blink.length"], other["blink.length"]),
        min_count=30,
        direction="lower",
        rate_dependent=True,
        source="Kantorovich 1942",
        caveat="as above",
    ),
    _blink(
        "blinks/depth",
        "mean blink depth",
        "closure",
        "mean of the largest closure of each blink; 1 is shut",
        compute=ratio("blink.depth", "blink.blinks"),
        min_count=30,
        rate_dependent=True,
        source="Sforza et al. 2008",
        caveat="frames can miss the moment of largest closure",
    ),
    _blink(
        "blinks/interval_cv",
        "variation of blink intervals",
        "CV",
        "SD / mean of the time between onsets within a clip",
        compute=variation("blink.interval"),
        count_key="blink.intervals",
        min_count=50,
        source="Doughty 2002",
        caveat="short clips truncate long intervals",
    ),
    Metric(
        "blinks/at_shifts",
        "blinks at gaze shifts",
        "rate ratio",
        "blink rate from -0.15 to 0.25 s around onsets of saccades of at least 8 deg / blink rate elsewhere",
        compute=partial(_coupling, name="shift"),
        extractor=SHIFTS,
        count_key="shift.blinks",
        min_count=50,
        source="Evinger et al. 1994",
        caveat="raised by trackers that report gaze jumps during blinks: inspect gaze within blinks",
    ),
    Metric(
        "blinks/at_phrase_ends",
        "blinks at phrase ends",
        "rate ratio",
        "blink rate from -0.1 to 0.5 s around ends of speech / blink rate elsewhere",
        compute=partial(_coupling, name="phrase"),
        extractor=PHRASES,
        count_key="phrase.blinks",
        min_count=100,
        source="Nakano & Kitazawa 2010",
        caveat="for phrases that end with the clip, only the part of the window inside the clip counts",
    ),
)


# Statistics of the reference ranges, from arrays pooled over clips (pooled.py).
NEAR_END_S = 0.5
SHIFT_DEG = (20.0, 30.0)
AT_SHIFT_S = (-0.1, 0.2)
MIN_SPEAKER_S = 60.0
SHUT_TOLERANCE = 0.02  # of closure, below the largest: counts as shut
STILL_PER_S = 0.15  # closure per second; slower lids are at rest


def extract_pool(speaker: str, behaviour: Behaviour, annotation: Annotation | None) -> PooledArrays:
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
    from scipy import stats

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
