"""Blink metrics: rate, duration, depth, regularity, and coupling to gaze shifts and phrase ends.

Blinks accompany gaze shifts (Evinger et al. 1994) and follow the ends of phrases (Nakano & Kitazawa 2010). A coupling
is the blink rate inside a window divided by the rate outside it, so that a higher blink rate alone does not raise it.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide

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


def _interval_variation(totals: Totals) -> Float[ndarray, " D"]:
    mean = safe_divide(totals["blink.interval_s"], totals["blink.intervals"])
    square = safe_divide(totals["blink.interval_s2"], totals["blink.intervals"])
    return safe_divide(np.sqrt(np.maximum(square - mean**2, 0)), mean)


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
        compute=_interval_variation,
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
