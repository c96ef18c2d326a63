"""Measures of where and how long a person looks, from fixations in short, cut segments.

Rates are events per observed second. Durations are restricted means of the Kaplan-Meier estimate (Kaplan & Meier 1958):
the mean time up to LONGEST_S, from fixations whose onset was seen, where those that a segment cuts count as censored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.stats import CensoredData, ecdf

from talkingeyes.evaluation.people.fixations import FixationRecord, Person

LONGEST_S = 1.5  # few segments last longer
MIN_EVENTS = 10  # below, a measure of a person is missing
MIN_TIME_S = 20.0


@dataclass(frozen=True)
class Measure:
    """A measure of one person in one state; NaN where the data do not suffice."""

    name: str
    title: str
    unit: str
    compute: Callable[[FixationRecord, Bool[ndarray, " N"], Float[ndarray, " 2"]], float]


def _away_share(record: FixationRecord, away: ndarray, home: ndarray) -> float:
    return float(record.duration_s[away].sum() / record.duration_s.sum())


def _shift_rate(record: FixationRecord, away: ndarray, home: ndarray) -> float:
    return float(record.continues.sum() / record.time_s.sum())


def _crossing_rate(start_away: bool) -> Callable[[FixationRecord, ndarray, ndarray], float]:
    def rate(record: FixationRecord, away: ndarray, home: ndarray) -> float:
        crossing = record.continues & (away[:-1] == start_away) & (away[1:] != start_away)
        time_s = float(record.time_s[away == start_away].sum())
        return float(crossing.sum() / time_s) if time_s >= MIN_EVENTS * 0.2 else np.nan

    return rate


def _duration(which_away: bool) -> Callable[[FixationRecord, ndarray, ndarray], float]:
    def duration(record: FixationRecord, away: ndarray, home: ndarray) -> float:
        chosen = (away == which_away) & ~record.is_first
        return restricted_mean_s(record.duration_s[chosen], record.is_last[chosen])

    return duration


def restricted_mean_s(durations_s: Float[ndarray, " N"], censored: Bool[ndarray, " N"]) -> float:
    """Kaplan-Meier mean up to LONGEST_S; NaN with fewer than MIN_EVENTS durations that ended."""
    if (~censored).sum() < MIN_EVENTS:
        return np.nan
    data = CensoredData(uncensored=durations_s[~censored], right=durations_s[censored])
    survival = ecdf(data).sf
    inside = survival.quantiles < LONGEST_S
    edges = np.concatenate([[0.0], survival.quantiles[inside], [LONGEST_S]])
    return float(np.diff(edges) @ np.concatenate([[1.0], survival.probabilities[inside]]))


def _size(quantile: float) -> Callable[[FixationRecord, ndarray, ndarray], float]:
    def size(record: FixationRecord, away: ndarray, home: ndarray) -> float:
        sizes = np.hypot(*record.shifts_deg.T)
        return float(np.quantile(sizes, quantile)) if len(sizes) >= MIN_EVENTS else np.nan

    return size


def _spread(axis: int) -> Callable[[FixationRecord, ndarray, ndarray], float]:
    def spread(record: FixationRecord, away: ndarray, home: ndarray) -> float:
        values = record.centre_deg[:, axis]
        mean = np.average(values, weights=record.duration_s)
        return float(np.sqrt(np.average((values - mean) ** 2, weights=record.duration_s)))

    return spread


def _horizontal_share(record: FixationRecord, away: ndarray, home: ndarray) -> float:
    shifts = np.abs(record.shifts_deg)
    return float((shifts[:, 0] > shifts[:, 1]).mean()) if len(shifts) >= MIN_EVENTS else np.nan


def _above_share(record: FixationRecord, away: ndarray, home: ndarray) -> float:
    if away.sum() < MIN_EVENTS:
        return np.nan
    above = record.centre_deg[away, 1] > home[1]
    return float(np.average(above, weights=record.duration_s[away]))


MEASURES: Sequence[Measure] = (
    Measure("away_share", "share of time away from the partner", "fraction", _away_share),
    Measure("shift_rate", "rate of shifts", "1/s", _shift_rate),
    Measure("leaving_rate", "rate of leaving the partner, per second at the partner", "1/s", _crossing_rate(False)),
    Measure("return_rate", "rate of returning, per second away", "1/s", _crossing_rate(True)),
    Measure("partner_fixation", f"fixation at the partner, mean up to {LONGEST_S:g} s", "s", _duration(False)),
    Measure("away_fixation", f"fixation away, mean up to {LONGEST_S:g} s", "s", _duration(True)),
    Measure("step_median", "median step", "deg", _size(0.5)),
    Measure("step_p90", "90th percentile of steps", "deg", _size(0.9)),
    Measure("horizontal_spread", "horizontal SD", "deg", _spread(0)),
    Measure("vertical_spread", "vertical SD", "deg", _spread(1)),
    Measure("horizontal_share", "share of steps more horizontal than vertical", "fraction", _horizontal_share),
    Measure("above_share", "share of time away above the partner", "fraction", _above_share),
)


def measure_person(person: Person, state: str) -> Mapping[str, float]:
    """All measures of a person in a state; NaN for each without MIN_TIME_S of observation."""
    record = person.records[state]
    if len(record) < MIN_EVENTS or record.time_s.sum() < MIN_TIME_S:
        return {measure.name: np.nan for measure in MEASURES}
    away = person.away(state)
    return {measure.name: measure.compute(record, away, person.home_deg) for measure in MEASURES}
