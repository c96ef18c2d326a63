"""Where and how long a person looks, from fixations in short, cut segments; distances between people in it.

Rates are events per observed second. Durations are restricted means of the Kaplan-Meier estimate (Kaplan & Meier 1958):
the mean time up to LONGEST_S, from fixations whose onset was seen, where those that a segment cuts count as censored.

The distance of speakers to recorded people is in units of the distance between people. For each measure: |median over
the speakers - median over the people| / mean absolute difference of two people. 1 means that the typical speaker is as
far from the typical person as two people are from each other. Halves of the people, six against six, are 0.4 to 0.5
apart on average, so a ratio below that is no merit.

Where fewer than MIN_SPEAKERS have enough data for a measure (a few seconds of listening each), all speakers are pooled,
relative to the home of each. Intervals resample people, and speakers where they are not pooled. A distance cannot be
negative, so resampling raises it, and intervals lie high.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.stats import CensoredData, ecdf

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, percentile_interval
from talkingeyes.evaluation.people.fixations import FixationRecord, Person, join_records
from talkingeyes.physiology.gaze_population import STATES

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


MIN_PEOPLE, MIN_SPEAKERS = 4, 5
HALVES = 200  # random halves of the people for the floor


@dataclass(frozen=True)
class Distance:
    """One measure of a group of speakers: its value, and its distance to people in person-to-person units."""

    value: float
    ratio: Estimate
    pooled: bool


@dataclass(frozen=True)
class StateDistance:
    """All measures that people and speakers have in one state, and the mean of their ratios."""

    distances: Mapping[str, Distance]
    mean_ratio: Estimate

    @property
    def largest(self) -> tuple[str, float]:
        """The measure with the largest ratio."""
        name = max(self.distances, key=lambda each: self.distances[each].ratio.value)
        return name, self.distances[name].ratio.value


@dataclass(frozen=True)
class PeopleValues:
    """Values of P people: a row for each measure, NaN where a person has too little data."""

    values: Float[ndarray, "M P"]

    @property
    def medians(self) -> Float[ndarray, " M"]:
        """Median over people; NaN where fewer than MIN_PEOPLE have the measure."""
        return np.where(np.isfinite(self.values).sum(axis=1) >= MIN_PEOPLE, _nan_median(self.values), np.nan)

    @property
    def ranges(self) -> Float[ndarray, "M 2"]:
        """Least and largest value."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return np.stack([np.nanmin(self.values, axis=1), np.nanmax(self.values, axis=1)], axis=1)

    @property
    def between_people(self) -> Float[ndarray, " M"]:
        """Mean absolute difference of two people."""
        first, second = np.triu_indices(self.values.shape[1], 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            return np.asarray(np.nanmean(np.abs(self.values[:, first] - self.values[:, second]), axis=1))


def people_values(people: Sequence[Person], state: str) -> PeopleValues:
    """Measure people in a state."""
    measured = [measure_person(person, state) for person in people]
    return PeopleValues(np.array([[each[measure.name] for each in measured] for measure in MEASURES]))


def pool_speakers(speakers: Sequence[Person]) -> Person:
    """All speakers as one, relative to their homes."""
    records: dict[str, FixationRecord] = {}
    for state in STATES:
        own = ((each.records[state], each.home_deg) for each in speakers)
        records[state] = join_records([replace(one, centre_deg=one.centre_deg - home_deg) for one, home_deg in own])
    return Person("all", records)


def measure_distance(
    people: PeopleValues, speakers: Sequence[Person], state: str, settings: BootstrapSettings
) -> StateDistance:
    """Distances of speakers to people in one state. The unit is that of all people in each resample."""
    ours = people_values(speakers, state)
    few = np.isfinite(ours.values).sum(axis=1) < MIN_SPEAKERS
    pooled = people_values([pool_speakers(speakers)], state).values[:, 0]
    unit = people.between_people

    def ratios(chosen: Int[ndarray, " P"], speakers_chosen: Int[ndarray, " S"]) -> tuple[ndarray, ndarray]:
        value = np.where(few, pooled, _nan_median(ours.values[:, speakers_chosen]))
        return value, np.abs(value - PeopleValues(people.values[:, chosen]).medians) / unit

    count, total = people.values.shape[1], len(speakers)
    value, ratio = ratios(np.arange(count), np.arange(total))
    rng = np.random.default_rng([settings.seed, count, total])
    resampled = []
    for _ in range(settings.n_resamples):
        chosen, speakers_chosen = (rng.integers(each, size=each) for each in (count, total))
        resampled.append(ratios(chosen, speakers_chosen)[1])
    draws = np.array(resampled)
    known = np.flatnonzero(np.isfinite(ratio)).tolist()
    distances = {
        MEASURES[index].name: Distance(
            float(value[index]), _estimate(ratio[index], draws[:, index], settings), bool(few[index])
        )
        for index in known
    }
    means = _nan_mean(draws[:, known])
    mean = (
        Estimate(np.nan, np.nan, np.nan) if not len(known) else _estimate(float(ratio[known].mean()), means, settings)
    )
    return StateDistance(distances, mean)


def measure_floor(people: PeopleValues, seed: int) -> Float[ndarray, " M"]:
    """Mean ratio of each measure between random halves of the people."""
    rng, count = np.random.default_rng(seed), people.values.shape[1]
    found = []
    for _ in range(HALVES):
        order = rng.permutation(count)
        one, other = (_nan_median(people.values[:, half]) for half in (order[: count // 2], order[count // 2 :]))
        found.append(np.abs(one - other) / people.between_people)
    return np.asarray(_nan_mean(np.array(found).T))


def _estimate(value: float, resampled: Float[ndarray, " D"], settings: BootstrapSettings) -> Estimate:
    return Estimate(float(value), *percentile_interval(resampled, settings))


def _nan_median(values: Float[ndarray, "M P"]) -> Float[ndarray, " M"]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all NaN: NaN
        return np.asarray(np.nanmedian(values, axis=1))


def _nan_mean(values: Float[ndarray, "M P"]) -> Float[ndarray, " M"]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmean(values, axis=1))
