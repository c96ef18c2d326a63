"""Looking at the partner and away: how much, how long, and when in speech (Argyle & Cook 1976; Kendon 1967).

Dwells that a clip cuts at its end count as censored (Kaplan & Meier 1958): leaving them out would make clips of eight
seconds say that nobody looks for longer than four.
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
    measurement,
    speaking_turns,
    utterances,
)

# Around the start and the end of an utterance, where the state counts.
START_S, END_S = (-0.2, 0.5), (-0.4, 0.2)
BEFORE_S = 2.0  # an onset needs so much of the clip before it to say since when gaze was averted
MAX_AVERSION_LAG_S = 0.5
MIN_SPEAKER_S = 60.0  # of a speaker, for a share of looking


def extract(speaker: str, behaviour: Behaviour, annotation: Annotation) -> PooledArrays:
    """Shares, dwells, and the states at both ends of utterances."""
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
    """Whether gaze is averted at both ends of long turns, and since when at the start of an utterance.

    Kendon's utterances are turns; where an aversion begins is asked of what follows a pause as well.
    """
    states, seconds = behaviour.states, len(behaviour) / behaviour.fps
    turns = [span for span in speaking_turns(annotation) if span.end_s - span.start_s >= MIN_LONG_UTTERANCE_S]
    starts = [_averted(behaviour, span.start_s, START_S) for span in turns if span.start_s + START_S[1] < seconds]
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


def by_speaker(pool: PooledArrays, what: str) -> Float[ndarray, " P"]:
    """Share of time looking at the partner of each speaker with a minute or more."""
    speakers, seconds = pool["look.speaker"], pool[f"look.{what}_s"]
    shares = []
    for speaker in np.unique(speakers):
        looked, total = seconds[speakers == speaker].sum(axis=0)
        if total >= MIN_SPEAKER_S:
            shares.append(looked / total)
    return np.array(shares)


def fraction(pool: PooledArrays, what: str) -> dict[str, Measurement]:
    """Mean and standard deviation over speakers."""
    shares = by_speaker(pool, what)
    nan = float("nan")
    return {
        "mean": measurement(
            float(shares.mean()) if len(shares) else nan, len(shares), f"speakers with a minute of {what}", 3
        ),
        "sd": measurement(
            float(shares.std(ddof=1)) if len(shares) > 1 else nan, len(shares), f"speakers with a minute of {what}", 5
        ),
    }


def listening_fraction(pool: PooledArrays) -> Measurement:
    """Share of listening time spent looking at the partner, all speakers together."""
    looked, total = pool["look.listening_s"].sum(axis=0)
    return measurement(looked / total if total else np.nan, int(total), "seconds of listening", 60)


def averted_at_utterances(pool: PooledArrays, end: str) -> Measurement:
    """Share of long turns at whose start (or end) gaze is averted."""
    found = pool[f"utterance.{end}_averted"]
    return measurement(float(found.mean()) if len(found) else np.nan, len(found), "long turns", 50)


def dwell_median(pool: PooledArrays, averted: bool) -> Measurement:
    """Median length of the dwells of one state, those that the clip cuts counted as at least so long."""
    chosen = (pool["dwell.averted"] == averted) & pool["dwell.talking"]
    length, censored = pool["dwell.s"][chosen], pool["dwell.cut"][chosen]
    return measurement(kaplan_meier_median(length, censored), len(length), "dwells", 50)


def kaplan_meier_median(length_s: Float[ndarray, " N"], censored: Bool[ndarray, " N"]) -> float:
    """The time that half of them survive; NaN if more than half last longer than anything that was seen whole."""
    order = np.argsort(length_s, kind="stable")
    at_risk = np.arange(len(order), 0, -1)
    alive = np.cumprod(1.0 - ~censored[order] / at_risk)
    below = np.flatnonzero(alive <= 0.5)
    return float(length_s[order][below[0]]) if len(below) else float("nan")


def aversion_lead(pool: PooledArrays) -> dict[str, Measurement]:
    """When the aversion at the start of an utterance began: median, and distance between the quartiles."""
    found = pool["aversion.before_onset_s"]
    if len(found) < 20:
        few = measurement(np.nan, len(found), "utterances with aversion", 20)
        return {"median": few, "iqr": few}
    low, middle, high = np.quantile(found, [0.25, 0.5, 0.75], method="nearest")
    low = max(float(low), -float(BEFORE_S))  # of those averted since before the clip no more is known
    return {
        "median": measurement(float(middle), len(found), "utterances with aversion"),
        "iqr": measurement(float(high) - low, len(found), "utterances with aversion"),
    }
