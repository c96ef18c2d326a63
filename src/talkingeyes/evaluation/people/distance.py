"""Distance of a group of speakers to recorded people, in units of the distance between people.

For each measure: |median over the speakers - median over the people| / mean absolute difference of two people. 1 means
that the typical speaker is as far from the typical person as two people are from each other. Halves of the people, six
against six, are 0.4 to 0.5 apart on average, so a ratio below that is no merit.

Where fewer than MIN_SPEAKERS have enough data for a measure (a few seconds of listening each), all speakers are pooled,
relative to the home of each. Intervals resample people, and speakers where they are not pooled. A distance cannot be
negative, so resampling raises it, and intervals lie high.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, percentile_interval
from talkingeyes.evaluation.people.fixations import FixationRecord, Person, join_records
from talkingeyes.evaluation.people.measures import MEASURES, measure_person
from talkingeyes.physiology.gaze_population import STATES

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
