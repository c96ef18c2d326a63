"""Gaze at the partner and gaze aversion: amount, duration and timing in speech (Argyle & Cook 1976; Kendon 1967).

Dwells that are cut off by the end of a clip are censored (Kaplan & Meier 1958). If they were left out, no dwell in
clips of eight seconds would seem to last longer than four.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.reference_ranges.clip_data import (
    MIN_LONG_UTTERANCE_S,
    Measurement,
    PooledArrays,
    in_spans,
    measure_values,
    measurement,
    speaking_turns,
    utterances,
)

# Windows around the start and the end of an utterance in which the gaze state is determined.
START_S, END_S = (-0.2, 0.5), (-0.4, 0.2)
BEFORE_S = 2.0  # time of the clip before an utterance that is needed to find the onset of an aversion
MAX_AVERSION_LAG_S = 0.5
MIN_SPEAKER_S = 60.0  # of a speaker, for a fraction of partner gaze


def extract(speaker: str, behaviour: Behaviour, annotation: Annotation) -> PooledArrays:
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
