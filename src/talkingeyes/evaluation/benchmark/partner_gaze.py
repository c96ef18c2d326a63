"""Metrics of gaze at the partner and gaze aversion: amount, duration, and timing relative to speech.

The aversion curve is the fraction of events at which gaze is averted, as a function of the lag; events are onsets and
offsets of speech, starts and ends of the speaker's turns, silent hesitations and fillers. People tend to begin to speak
with gaze averted, to avert it when they hesitate, and to finish with gaze at the partner (Kendon 1967; Ho, Foulsham &
Kingstone 2015). At onsets and offsets the effect is weak: below MIN_EVENTS the curve is noise. Onsets in the first two
seconds of a clip are left out: recordings begin alike, with silence and then speech, so that motion under any other
sound shows part of the effect. Where a clip begins or ends within speech, a turn or a pause is no event.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide

LAGS_S = np.arange(-20, 21) / 10
DURATION_BINS_S = Bins(0.0, 8.0, 80)
# Speaking spans with a shorter gap between them count as one.
MIN_PAUSE_S = 0.25
MIN_EVENTS, MIN_PAUSES, MIN_TURNS = 350, 100, 40  # the larger the effect, the fewer
# Kinds of events and the unit of their counts.
EVENTS = {
    "onset": "speech_onsets",
    "offset": "speech_offsets",
    "turn_start": "turn_starts",
    "turn_end": "turn_ends",
    "hesitation": "hesitations",
    "filler": "fillers",
}
FIRST_ONSET_S = 2.0
# Windows of lags in seconds: before, around and after onsets; before and after offsets; at ends of turns and in pauses.
BEFORE_ONSET_S, AT_ONSET_S, AFTER_ONSET_S = (-2.0, -1.4), (-0.3, 0.7), (1.4, 2.0)
BEFORE_OFFSET_S, AFTER_OFFSET_S, AT_OFFSET_S = (-1.0, 0.0), (0.4, 1.2), (-0.4, 0.0)
AFTER_TURN_S, IN_PAUSE_S = (0.4, 1.4), (0.2, 0.8)


def extract_states(behaviour: Behaviour) -> Sums:
    """Time averted, and durations of the aversions and looks at the partner that lie within the clip."""
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
        "state.looks": looks.sum(),
        "state.aversion": DURATION_BINS_S(length[whole]),
        "state.look": DURATION_BINS_S(length[looks]),
    }


def extract_aversion_curves(behaviour: Behaviour) -> Sums:
    """Averted and counted frames around each kind of event, by lag."""
    assert behaviour.annotation is not None
    sums: dict[str, float | ndarray] = {}
    for event, times_s in event_times(behaviour.annotation, len(behaviour) / behaviour.fps).items():
        averted, counted = _around(behaviour, np.array(times_s))
        sums |= {f"{event}.{EVENTS[event]}": len(times_s), f"{event}.averted": averted, f"{event}.counted": counted}
    return sums


def event_times(annotation: Annotation, seconds: float) -> dict[str, list[float]]:
    """Times in seconds of the events of a clip, by the names of EVENTS."""
    spans = annotation.speaking
    gaps = [after.start_s - before.end_s for before, after in pairwise(spans)]
    apart = [np.inf, *gaps, np.inf]
    starts = [span.start_s for span, gap in zip(spans, apart[:-1], strict=False) if gap >= MIN_PAUSE_S]
    ends = [span.end_s for span, gap in zip(spans, apart[1:], strict=False) if gap >= MIN_PAUSE_S]

    def inside(times_s: Iterable[float]) -> list[float]:
        return [time_s for time_s in times_s if MIN_PAUSE_S <= time_s <= seconds - MIN_PAUSE_S]

    return {
        "onset": [time_s for time_s in starts if time_s >= FIRST_ONSET_S],
        "offset": [time_s for time_s in ends if time_s <= seconds - MIN_PAUSE_S],
        "turn_start": inside(span.end_s for span in annotation.listening),
        "turn_end": inside(span.start_s for span in annotation.listening),
        "hesitation": inside(span.start_s for span in annotation.pauses if span.label == "hesitation"),
        "filler": inside(span.start_s for span in annotation.fillers),
    }


def _around(behaviour: Behaviour, times_s: Float[ndarray, " N"]) -> Float[ndarray, "2 L"]:
    """Number of averted and of all valid frames at each lag from the times."""
    frame = np.round((times_s[:, None] + LAGS_S) * behaviour.fps).astype(int)
    inside = (frame >= 0) & (frame < len(behaviour))
    frame = np.where(inside, frame, 0)
    counted = inside & behaviour.valid[frame]
    return np.stack([(counted & behaviour.states.averted[frame]).sum(axis=0), counted.sum(axis=0)]).astype(float)


STATES = Extractor(extract_states, ("head", "gaze"))
CURVES = Extractor(extract_aversion_curves, ("head", "gaze", "annotation"))


def aversion_curve(totals: Totals, event: str) -> Float[ndarray, "D L"]:
    """Fraction averted at each lag around `event`, of EVENTS."""
    return safe_divide(totals[f"{event}.averted"], totals[f"{event}.counted"])


def _share(totals: Totals, event: str, window_s: tuple[float, float]) -> Float[ndarray, " D"]:
    """Fraction averted in a window of lags."""
    within = (window_s[0] - 1e-9 <= LAGS_S) & (window_s[1] + 1e-9 >= LAGS_S)
    averted, counted = (totals[f"{event}.{name}"][:, within].sum(axis=1) for name in ("averted", "counted"))
    return safe_divide(averted, counted)


def _change(totals: Totals, event: str, to: tuple[float, float], base: tuple[float, float]) -> Float[ndarray, " D"]:
    """Fraction averted in window `to` less that in window `base`."""
    return np.asarray(_share(totals, event, to) - _share(totals, event, base))


def _shape(totals: Totals, other: Totals, event: str) -> Float[ndarray, " D"]:
    """Correlation of the curve with that of the reference, over lags."""
    one, two = (aversion_curve(each, event) for each in (totals, other))
    one, two = (each - each.mean(axis=1, keepdims=True) for each in (one, two))
    scale = np.sqrt(np.square(one).sum(axis=1) * np.square(two).sum(axis=1))
    return np.asarray((one * two).sum(axis=1) / np.maximum(scale, 1e-12))


_state = partial(Metric, extractor=STATES, source="Argyle & Cook 1976; Kendon 1967")


def _around_event(event: str, min_count: int) -> Callable[..., Metric]:
    """Metric of the curve around one kind of event."""
    return partial(Metric, extractor=CURVES, count_key=f"{event}.{EVENTS[event]}", min_count=min_count)


_onset, _offset = (_around_event(event, MIN_EVENTS) for event in ("onset", "offset"))


def _event_rise(event: str, title: str, to: tuple[float, float], min_count: int, source: str) -> Metric:
    return _around_event(event, min_count)(
        f"{event}/rise",
        f"averted at {title}, rise",
        "fraction",
        f"fraction averted from {to[0]:g} to {to[1]:g} s around {title} less that from -2 to -1.4 s",
        compute=partial(_change, event=event, to=to, base=BEFORE_ONSET_S),
        source=source,
        caveat="needs an annotation of turns, hesitations and fillers; negative at ends of turns",
    )


def _curve_shape(event: str, family: str, title: str, min_count: int, source: str) -> Metric:
    return _around_event(event, min_count)(
        f"{family}/shape",
        f"shape of the aversion curve at {title}",
        "correlation",
        "correlation of the curve with that of the reference over lags of -2 to 2 s",
        compare=partial(_shape, event=event),
        direction="higher",
        source=source,
        caveat=(
            "noise also gives correlations away from 0: compare with the correlation between the halves of the "
            "reference"
        ),
    )


METRICS = (
    _state(
        "partner_gaze/fraction",
        "time looking at the partner",
        "fraction",
        "fraction of valid frames with gaze in space within 4 deg of the partner",
        compute=lambda totals: 1 - safe_divide(totals["state.averted"], totals["state.frames"]),
        count_key="state.seconds",
        min_count=60,
        caveat=(
            "the partner is assumed at the densest location of gaze, which is wrong for people who look away most "
            "of the time; a frozen face has 1"
        ),
    ),
    _state(
        "partner_gaze/aversion_rate",
        "aversion rate",
        "1/min",
        "changes from partner to averted / minutes",
        compute=ratio("state.onsets", "state.seconds", 60.0),
        count_key="state.seconds",
        min_count=60,
        caveat="includes small saccades across the border of the partner's region",
    ),
    _state(
        "partner_gaze/aversion_median",
        "median aversion duration",
        "s",
        "median duration of aversions that begin and end within the clip",
        compute=lambda totals: DURATION_BINS_S.quantile(totals["state.aversion"], 0.5),
        count_key="state.aversions",
        min_count=50,
        source="Andrist, Mutlu & Gleicher 2013",
        caveat="short clips exclude long aversions: compare clips of one length",
    ),
    _state(
        "partner_gaze/aversion_distance",
        "aversion durations, Wasserstein",
        "SD of truth",
        "area between the distribution functions of aversion duration / SD of the reference's",
        compare=lambda totals, other: DURATION_BINS_S.distance(totals["state.aversion"], other["state.aversion"]),
        count_key="state.aversions",
        min_count=100,
        direction="lower",
        caveat="as above",
    ),
    _state(
        "partner_gaze/dwell_distance",
        "dwell times at the partner, Wasserstein",
        "SD of truth",
        "area between the distribution functions of dwell time at the partner / SD of the reference's",
        compare=lambda totals, other: DURATION_BINS_S.distance(totals["state.look"], other["state.look"]),
        count_key="state.looks",
        min_count=100,
        direction="lower",
        caveat="as above",
    ),
    _onset(
        "speech_onset/averted",
        "averted at speech onsets",
        "fraction",
        "fraction averted from -0.3 to 0.7 s around speech onsets after at least 0.25 s of silence",
        compute=partial(_share, event="onset", window_s=AT_ONSET_S),
        source="Kendon 1967; Ho, Foulsham & Kingstone 2015",
        caveat="depends on the total time at the partner: read it together with the rise",
    ),
    _onset(
        "speech_onset/rise",
        "averted at speech onsets, rise",
        "fraction",
        "fraction averted from -0.3 to 0.7 s less that from -2 to -1.4 s, around the same onsets",
        compute=partial(_change, event="onset", to=AT_ONSET_S, base=BEFORE_ONSET_S),
        source="Kendon 1967; Ho, Foulsham & Kingstone 2015",
        caveat="onsets in the first two seconds are left out",
    ),
    _onset(
        "speech_onset/drop",
        "averted after speech onsets, drop",
        "fraction",
        "fraction averted from -0.3 to 0.7 s less that from 1.4 to 2 s, around the same onsets",
        compute=partial(_change, event="onset", to=AT_ONSET_S, base=AFTER_ONSET_S),
        source="Andrist, Mutlu & Gleicher 2013",
        caveat="lags beyond the end of the clip do not count",
    ),
    _curve_shape("onset", "speech_onset", "onsets", MIN_EVENTS, "Ho, Foulsham & Kingstone 2015"),
    _offset(
        "speech_offset/averted",
        "averted before speech offsets",
        "fraction",
        "fraction averted in the last 0.4 s before speech offsets followed by at least 0.25 s of silence",
        compute=partial(_share, event="offset", window_s=AT_OFFSET_S),
        source="Kendon 1967 (people look at the partner when they finish)",
        caveat="depends on the total time at the partner",
    ),
    _offset(
        "speech_offset/rise",
        "averted after speech offsets, rise",
        "fraction",
        "fraction averted from 0.4 to 1.2 s less that from -1 to 0 s, around the same offsets",
        compute=partial(_change, event="offset", to=AFTER_OFFSET_S, base=BEFORE_OFFSET_S),
        source="Kendon 1967",
        caveat="mixes pauses, where the next aversion begins, with ends of turns, where gaze returns",
    ),
    _curve_shape("offset", "speech_offset", "offsets", MIN_EVENTS, "Kendon 1967"),
    _event_rise("turn_start", "starts of turns", AT_ONSET_S, MIN_TURNS, "Ho, Foulsham & Kingstone 2015"),
    _curve_shape("turn_start", "turn_start", "starts of turns", MIN_TURNS, "Ho, Foulsham & Kingstone 2015"),
    _event_rise("turn_end", "ends of turns", AFTER_TURN_S, MIN_TURNS, "Ho, Foulsham & Kingstone 2015"),
    _curve_shape("turn_end", "turn_end", "ends of turns", MIN_TURNS, "Ho, Foulsham & Kingstone 2015"),
    _event_rise("hesitation", "silent hesitations", IN_PAUSE_S, MIN_PAUSES, "Kendon 1967"),
    _curve_shape("hesitation", "hesitation", "silent hesitations", MIN_PAUSES, "Kendon 1967"),
    _event_rise("filler", "fillers", IN_PAUSE_S, MIN_PAUSES, "Jehoul et al."),
)
