"""Measures of looking at the partner and away: how much, how long, and when in speech.

The averted curve is the share of speech onsets (offsets) at which gaze is averted, at each lag around them. People
start to speak with gaze averted and end with it on the partner (Kendon 1967; Ho, Foulsham & Kingstone 2015), but
loosely: below some 400 onsets the curve is noise.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide

LAGS_S = np.arange(-20, 21) / 10
DURATION_BINS_S = Bins(0.0, 8.0, 80)
# A gap shorter than this does not end speech.
MIN_PAUSE_S = 0.25
MIN_EVENTS = 400
# Windows of lags in seconds: before, around and after onsets; before and after offsets.
BEFORE_ONSET_S, AT_ONSET_S, AFTER_ONSET_S = (-2.0, -1.4), (-0.3, 0.7), (1.4, 2.0)
BEFORE_OFFSET_S, AFTER_OFFSET_S, AT_OFFSET_S = (-1.0, 0.0), (0.4, 1.2), (-0.4, 0.0)


def extract_states(behaviour: Behaviour) -> Sums:
    """Time averted, and lengths of the aversions that the clip does not cut."""
    states = behaviour.states
    whole = states.dwell_averted.copy()
    whole[[0, -1]] = False
    looks = ~states.dwell_averted
    looks[[0, -1]] = False
    length = states.duration_s
    return {
        "state.frames": behaviour.valid.sum(),
        "state.seconds": behaviour.valid.sum() / behaviour.fps,
        "state.averted": (states.averted & behaviour.valid).sum(),
        "state.onsets": states.dwell_averted[1:].sum(),
        "state.aversions": whole.sum(),
        "state.aversion": DURATION_BINS_S(length[whole]),
        "state.looks": looks.sum(),
        "state.look": DURATION_BINS_S(length[looks]),
    }


def extract_aversion_curves(behaviour: Behaviour) -> Sums:
    """Averted frames around speech onsets and offsets, by lag."""
    assert behaviour.annotation is not None
    spans = behaviour.annotation.speaking
    gaps = [after.start_s - before.end_s for before, after in pairwise(spans)]
    apart = [np.inf, *gaps, np.inf]
    start = [span.start_s for span, gap in zip(spans, apart[:-1], strict=False) if gap >= MIN_PAUSE_S]
    end = [span.end_s for span, gap in zip(spans, apart[1:], strict=False) if gap >= MIN_PAUSE_S]
    onset, offset = (_around(behaviour, np.array(times)) for times in (start, end))
    return {
        "onset.speech_onsets": len(start),
        "onset.averted": onset[0],
        "onset.counted": onset[1],
        "offset.speech_offsets": len(end),
        "offset.averted": offset[0],
        "offset.counted": offset[1],
    }


def _around(behaviour: Behaviour, times_s: Float[ndarray, " N"]) -> Float[ndarray, "2 L"]:
    """Averted, and all, of the valid frames at each lag from the times."""
    frame = np.round((times_s[:, None] + LAGS_S) * behaviour.fps).astype(int)
    inside = (frame >= 0) & (frame < len(behaviour))
    frame = np.where(inside, frame, 0)
    counted = inside & behaviour.valid[frame]
    return np.stack([(counted & behaviour.states.averted[frame]).sum(axis=0), counted.sum(axis=0)]).astype(float)


STATES = Extractor(
    extract_states,
    ("head", "gaze"),
    {
        **dict.fromkeys(
            ("state.frames", "state.seconds", "state.averted", "state.onsets", "state.aversions", "state.looks"), 1
        ),
        "state.aversion": DURATION_BINS_S.count,
        "state.look": DURATION_BINS_S.count,
    },
)
CURVES = Extractor(
    extract_aversion_curves,
    ("head", "gaze", "annotation"),
    {
        "onset.speech_onsets": 1,
        "onset.averted": len(LAGS_S),
        "onset.counted": len(LAGS_S),
        "offset.speech_offsets": 1,
        "offset.averted": len(LAGS_S),
        "offset.counted": len(LAGS_S),
    },
)


def aversion_curve(totals: Totals, event: str) -> Float[ndarray, "D L"]:
    """The averted curve."""
    return safe_divide(totals[f"{event}.averted"], totals[f"{event}.counted"])


def _share(totals: Totals, event: str, window_s: tuple[float, float]) -> Float[ndarray, " D"]:
    """Share averted over a window of lags."""
    within = (window_s[0] - 1e-9 <= LAGS_S) & (window_s[1] + 1e-9 >= LAGS_S)
    averted, counted = (totals[f"{event}.{name}"][:, within].sum(axis=1) for name in ("averted", "counted"))
    return safe_divide(averted, counted)


def _change(totals: Totals, event: str, to: tuple[float, float], base: tuple[float, float]) -> Float[ndarray, " D"]:
    """Share averted in one window of lags less that in another."""
    return np.asarray(_share(totals, event, to) - _share(totals, event, base))


def _shape(totals: Totals, other: Totals, event: str) -> Float[ndarray, " D"]:
    """Correlation of the curve with the reference's, over lags."""
    one, two = (aversion_curve(each, event) for each in (totals, other))
    one, two = (each - each.mean(axis=1, keepdims=True) for each in (one, two))
    scale = np.sqrt(np.square(one).sum(axis=1) * np.square(two).sum(axis=1))
    return np.asarray((one * two).sum(axis=1) / np.maximum(scale, 1e-12))


_state = partial(Metric, extractor=STATES, source="Argyle & Cook 1976; Kendon 1967")
_onset = partial(Metric, extractor=CURVES, count_key="onset.speech_onsets", min_count=MIN_EVENTS)
_offset = partial(Metric, extractor=CURVES, count_key="offset.speech_offsets", min_count=MIN_EVENTS)

METRICS = (
    _state(
        "partner_gaze/fraction",
        "time at the partner",
        "share",
        "share of valid frames with gaze in space within 4 deg of the partner",
        compute=lambda totals: 1 - safe_divide(totals["state.averted"], totals["state.frames"]),
        count_key="state.seconds",
        min_count=60,
        caveat=(
            "where the partner is, is the densest place of gaze: whoever looks away most of the time has it "
            "wrong; a frozen face has 1"
        ),
    ),
    _state(
        "partner_gaze/aversion_rate",
        "aversions",
        "1/min",
        "changes from the partner to away / minutes",
        compute=ratio("state.onsets", "state.seconds", 60.0),
        count_key="state.seconds",
        min_count=60,
        caveat="small saccades across the border of the face count",
    ),
    _state(
        "partner_gaze/aversion_median",
        "length of aversions",
        "s",
        "median of the aversions that begin and end in the clip",
        compute=lambda totals: DURATION_BINS_S.quantile(totals["state.aversion"], 0.5),
        count_key="state.aversions",
        min_count=50,
        source="Andrist, Mutlu & Gleicher 2013",
        caveat="short clips cut the long ones away: compare clips of one length",
    ),
    _state(
        "partner_gaze/aversion_distance",
        "lengths of aversions, Wasserstein",
        "truth's SD",
        "area between the distribution functions of aversion length / SD of the reference's",
        compare=lambda totals, other: DURATION_BINS_S.distance(totals["state.aversion"], other["state.aversion"]),
        count_key="state.aversions",
        min_count=100,
        direction="lower",
        caveat="as above",
    ),
    _state(
        "partner_gaze/dwell_distance",
        "lengths of looks, Wasserstein",
        "truth's SD",
        "area between the distribution functions of the dwells at the partner / SD of the reference's",
        compare=lambda totals, other: DURATION_BINS_S.distance(totals["state.look"], other["state.look"]),
        count_key="state.looks",
        min_count=100,
        direction="lower",
        caveat="as above",
    ),
    _onset(
        "speech_onset/averted",
        "averted at speech onsets",
        "share",
        "share averted from -0.3 to 0.7 s around onsets of speech after 0.25 s of silence",
        compute=partial(_share, event="onset", window_s=AT_ONSET_S),
        source="Kendon 1967; Ho, Foulsham & Kingstone 2015",
        caveat="follows the time at the partner: read it beside the rise",
    ),
    _onset(
        "speech_onset/rise",
        "averted at speech onsets, rise",
        "share",
        "averted from -0.3 to 0.7 s less averted from -2 to -1.4 s, around onsets of speech after 0.25 s of silence",
        compute=partial(_change, event="onset", to=AT_ONSET_S, base=BEFORE_ONSET_S),
        source="Kendon 1967; Ho, Foulsham & Kingstone 2015",
        caveat="clips that start with speech have no base: their lags before 0 do not count",
    ),
    _onset(
        "speech_onset/drop",
        "averted after speech onsets, drop",
        "share",
        "averted from -0.3 to 0.7 s less averted from 1.4 to 2 s, around the same onsets",
        compute=partial(_change, event="onset", to=AT_ONSET_S, base=AFTER_ONSET_S),
        source="Andrist, Mutlu & Gleicher 2013",
        caveat="clips that end early do not count",
    ),
    _onset(
        "speech_onset/shape",
        "averted curve at onsets, shape",
        "correlation",
        "correlation of the curve with the reference's over lags of -2 to 2 s",
        compare=partial(_shape, event="onset"),
        direction="higher",
        source="Ho, Foulsham & Kingstone 2015",
        caveat=(
            "a correlation of noise with noise is 0 on average but not each time: read it beside that of the "
            "reference's halves"
        ),
    ),
    _offset(
        "speech_offset/averted",
        "averted as speech ends",
        "share",
        "share averted in the last 0.4 s before ends of speech that 0.25 s of silence follow",
        compute=partial(_share, event="offset", window_s=AT_OFFSET_S),
        source="Kendon 1967 (people end looking)",
        caveat="follows the time at the partner",
    ),
    _offset(
        "speech_offset/rise",
        "averted after speech, rise",
        "share",
        "averted from 0.4 to 1.2 s less averted from -1 to 0 s, around the same ends",
        compute=partial(_change, event="offset", to=AFTER_OFFSET_S, base=BEFORE_OFFSET_S),
        source="Kendon 1967",
        caveat="mixes pauses, in which the next aversion begins, with ends of turns, at which gaze returns",
    ),
    _offset(
        "speech_offset/shape",
        "averted curve at offsets, shape",
        "correlation",
        "correlation of the curve with the reference's over lags of -2 to 2 s",
        compare=partial(_shape, event="offset"),
        direction="higher",
        source="Kendon 1967",
        caveat="as at onsets",
    ),
)
