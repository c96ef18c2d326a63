"""Gaze at the partner and gaze aversion: amount, duration, and timing relative to speech.

The aversion curve is the fraction of events at which gaze is averted, as a function of the lag; events are onsets and
offsets of speech, starts and ends of the speaker's turns, silent hesitations and fillers. People tend to begin to speak
with gaze averted, to avert it when they hesitate, and to finish with gaze at the partner (Kendon 1967; Ho, Foulsham &
Kingstone 2015). At onsets and offsets the effect is weak: below MIN_EVENTS the curve is noise. Onsets in the first two
seconds of a clip are left out: recordings begin alike, with silence and then speech, so that motion under any other
sound shows part of the effect. Where a clip begins or ends within speech, a turn or a pause is no event.

The reference ranges (Argyle & Cook 1976; Kendon 1967) have amounts by speaker and the duration of dwells. Dwells that
are cut off by the end of a clip are censored (Kaplan & Meier 1958). If they were left out, no dwell in clips of eight
seconds would seem to last longer than four.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide
from talkingeyes.evaluation.measures.pooled import (
    MIN_LONG_UTTERANCE_S,
    Measurement,
    PooledArrays,
    in_spans,
    measure_values,
    measurement,
    speaking_turns,
    utterances,
)

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
        averted, counted = averted_around(behaviour.states.averted, behaviour.valid, behaviour.fps, np.array(times_s))
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


def averted_around(
    averted: Bool[ndarray, " T"],
    valid: Bool[ndarray, " T"],
    fps: float,
    times_s: Float[ndarray, " N"],
    lags_s: Float[ndarray, " L"] = LAGS_S,
) -> Float[ndarray, "2 L"]:
    """Number of averted and of all valid frames at each lag from the times."""
    frame = np.round((times_s[:, None] + lags_s) * fps).astype(int)
    inside = (frame >= 0) & (frame < len(averted))
    frame = np.where(inside, frame, 0)
    counted = inside & valid[frame]
    return np.stack([(counted & averted[frame]).sum(axis=0), counted.sum(axis=0)]).astype(float)


STATES = Extractor(extract_states, ("head", "gaze"))
CURVES = Extractor(extract_aversion_curves, ("head", "gaze", "annotation"))


def aversion_curve(totals: Totals, event: str) -> Float[ndarray, "D L"]:
    """Fraction averted at each lag around `event`, of EVENTS."""
    return safe_divide(totals[f"{event}.averted"], totals[f"{event}.counted"])


def share_in_window(
    curve: Float[ndarray, "*D 2 L"], window_s: tuple[float, float], lags_s: Float[ndarray, " L"] = LAGS_S
) -> Float[ndarray, "*D"]:
    """Fraction averted in a window of lags, of the sums of `averted_around`."""
    within = (window_s[0] - 1e-9 <= lags_s) & (window_s[1] + 1e-9 >= lags_s)
    sums = curve[..., within].sum(axis=-1)
    return safe_divide(np.asarray(sums[..., 0]), np.asarray(sums[..., 1]))


def _share(totals: Totals, event: str, window_s: tuple[float, float]) -> Float[ndarray, " D"]:
    """Fraction averted in a window of lags."""
    return share_in_window(np.stack([totals[f"{event}.{name}"] for name in ("averted", "counted")], axis=-2), window_s)


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


# Statistics of the reference ranges, from arrays pooled over clips (pooled.py).
# Windows around the start and the end of an utterance in which the gaze state is determined.
START_S, END_S = (-0.2, 0.5), (-0.4, 0.2)
BEFORE_S = 2.0  # time of the clip before an utterance that is needed to find the onset of an aversion
MAX_AVERSION_LAG_S = 0.5
MIN_SPEAKER_S = 60.0  # of a speaker, for a fraction of partner gaze


def extract_pool(speaker: str, behaviour: Behaviour, annotation: Annotation) -> PooledArrays:
    """Time looking at the partner, dwells, and gaze states at both ends of utterances."""
    states, fps = behaviour.states, behaviour.fps
    talks = in_spans(speaking_turns(annotation), behaviour) & behaviour.valid
    listens = in_spans(annotation.listening, behaviour) & behaviour.valid
    looks = ~states.averted
    last = np.zeros(len(states.onset_s), bool)
    last[-1:] = True
    whole = np.arange(len(last)) > 0  # the first dwell began before the clip
    in_talk = talks[np.round(states.onset_s * fps).astype(int)]
    return {
        "look.speaker": np.array([speaker]),
        "look.talking_s": np.array([[looks[talks].sum(), talks.sum()]]) / fps,
        "look.listening_s": np.array([[looks[listens].sum(), listens.sum()]]) / fps,
        "dwell.s": states.duration_s[whole],
        "dwell.averted": states.dwell_averted[whole],
        "dwell.cut": last[whole],
        "dwell.talking": in_talk[whole],
        **_around_utterances(behaviour, annotation),
    }


def _around_utterances(behaviour: Behaviour, annotation: Annotation) -> dict[str, ndarray]:
    """Whether gaze is averted at both ends of long turns, and onsets of aversions relative to long utterances.

    Kendon's utterances are turns. Aversion onsets are also measured at utterances after a pause within a turn.
    """
    states, seconds = behaviour.states, len(behaviour) / behaviour.fps
    turns = [span for span in speaking_turns(annotation) if span.end_s - span.start_s >= MIN_LONG_UTTERANCE_S]
    whole = [span for span in turns if span.start_s > 0]  # the others began before the clip
    starts = [_averted(behaviour, span.start_s, START_S) for span in whole if span.start_s + START_S[1] < seconds]
    ends = [_averted(behaviour, span.end_s, END_S) for span in turns if span.end_s + END_S[1] < seconds]
    onsets = []
    for span in utterances(annotation):
        covering = (
            states.dwell_averted
            & (states.onset_s <= span.start_s + MAX_AVERSION_LAG_S)
            & (states.offset_s > span.start_s)
        )
        if span.start_s >= BEFORE_S and span.end_s - span.start_s >= MIN_LONG_UTTERANCE_S and covering.any():
            first = int(covering.argmax())
            onsets.append(states.onset_s[first] - span.start_s if first else -np.inf)
    return {
        "utterance.start_averted": np.array(starts, float),
        "utterance.end_averted": np.array(ends, float),
        "aversion.before_onset_s": np.array(onsets, float),
    }


def _averted(behaviour: Behaviour, at_s: float, window_s: tuple[float, float]) -> bool:
    low, high = (max(0, round((at_s + edge) * behaviour.fps)) for edge in window_s)
    return bool(behaviour.states.averted[low : max(high, low + 1)].mean() > 0.5)


def by_speaker(pool: PooledArrays) -> Float[ndarray, " P"]:
    """Fraction of time looking at the partner, of each speaker with at least a minute of talking."""
    speakers, seconds = pool["look.speaker"], pool["look.talking_s"]
    shares = []
    for speaker in np.unique(speakers):
        looked, total = seconds[speakers == speaker].sum(axis=0)
        if total >= MIN_SPEAKER_S:
            shares.append(looked / total)
    return np.array(shares)


def partner_gaze_fraction(pool: PooledArrays) -> dict[str, Measurement]:
    """Mean and standard deviation over speakers of the fraction of partner gaze while talking."""
    shares, unit = by_speaker(pool), "speakers with a minute of talking"
    return {
        "partner_gaze": measure_values(shares, np.mean, unit, 3),
        "partner_gaze_sd": measurement(float(shares.std(ddof=1)) if len(shares) > 1 else np.nan, len(shares), unit, 5),
    }


def listening_fraction(pool: PooledArrays) -> Measurement:
    """Fraction of listening time with gaze at the partner, all speakers together."""
    looked, total = pool["look.listening_s"].sum(axis=0)
    return measurement(looked / total if total else np.nan, int(total), "seconds of listening", 60)


def averted_at_utterances(pool: PooledArrays, end: str) -> Measurement:
    """Fraction of long turns with gaze averted at the start (or end)."""
    return measure_values(pool[f"utterance.{end}_averted"], np.mean, "long turns", 50)


def dwell_median(pool: PooledArrays, averted: bool) -> Measurement:
    """Median duration of the dwells in one gaze state, with those cut off by the clip as censored."""
    chosen = (pool["dwell.averted"] == averted) & pool["dwell.talking"]
    length, censored = pool["dwell.s"][chosen], pool["dwell.cut"][chosen]
    return measurement(kaplan_meier_median(length, censored), len(length), "dwells", 50)


def kaplan_meier_median(length_s: Float[ndarray, " N"], censored: Bool[ndarray, " N"]) -> float:
    """Kaplan-Meier median of durations; NaN if the survival function does not reach 0.5."""
    order = np.argsort(length_s, kind="stable")
    at_risk = np.arange(len(order), 0, -1)
    survival = np.cumprod(1.0 - ~censored[order] / at_risk)
    below = np.flatnonzero(survival <= 0.5)
    return float(length_s[order][below[0]]) if len(below) else float("nan")


def aversion_lead(pool: PooledArrays) -> dict[str, Measurement]:
    """Onset of the aversion relative to the start of the utterance: median and interquartile range."""
    found = pool["aversion.before_onset_s"]
    if len(found) < 20:
        few = measurement(np.nan, len(found), "utterances with aversion", 20)
        return {"aversion_lead": few, "aversion_lead_iqr": few}
    low, middle, high = np.quantile(found, [0.25, 0.5, 0.75], method="nearest")
    low = max(float(low), -float(BEFORE_S))  # for aversions from before the clip only this bound is known
    return {
        "aversion_lead": measurement(float(middle), len(found), "utterances with aversion"),
        "aversion_lead_iqr": measurement(float(high) - low, len(found), "utterances with aversion"),
    }
