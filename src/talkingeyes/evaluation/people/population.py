"""Estimate a population of gaze (physiology/gaze_population.py) from recorded fixations.

Each person's parameters are estimated by maximum likelihood: log-normal waiting times with the cuts of segments as
censoring (fixations whose onset was not seen are left out), the next place by counts, places away by moments. Over
people, mean and standard deviation follow DerSimonian & Laird 1986, which takes the estimation error off the spread;
correlations are shrunk (Ledoit & Wolf 2004), as there are more parameters than people.

A recording is not the gaze: noise and dispersion join and split fixations, and losses cut them. The estimates are those
whose gaze, seen through the simulated tracker (tracker.py), gives what was recorded (indirect inference, Gourieroux,
Monfort & Renault 1993): simulate people, record them, estimate, and move each parameter by what it differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.stats import CensoredData, norm

from talkingeyes.corpus.gaze_datasets import CONVERSATION_RATE_HZ
from talkingeyes.evaluation.people.fixations import Person
from talkingeyes.evaluation.people.tracker import BLINKS_PER_S, TRACKER, GazeClip, Tracker, record_person
from talkingeyes.physiology.gaze_population import (
    PERSON_PARAMETERS,
    STATES,
    GazeHabits,
    GazePopulation,
    PersonParameter,
    SharedParameters,
    StatePopulation,
    sample_habits,
)

RESAMPLES = 200  # of people, for standard errors
MIN_EVENTS = 10  # of a person and state, for an estimate of his own
EM_STEPS = 30
SIMULATED_PEOPLE, SIMULATED_S, CLIP_S = 96, 180.0, 60.0
ROUNDS = 5
SD_FACTORS = (0.67, 1.5)  # of the recorded ones: steps hide how much the places of people differ
SACCADE_S = 0.04
RETURN_PLACES, RETURN_DEG = 6, 2.0


@dataclass(frozen=True)
class Estimate:
    """A person's parameter and its standard error."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class Fixations:
    """N fixations of one person in one state: time to the next shift, whether it was seen, places from the partner."""

    waited_s: Float[ndarray, " N"]
    ended: Bool[ndarray, " N"]
    onset_seen: Bool[ndarray, " N"]
    away: Bool[ndarray, " N"]
    place_deg: Float[ndarray, "N 2"]

    @classmethod
    def of(cls, person: Person, state: str) -> Fixations:
        """Those of a recording."""
        record = person.records[state]
        place = record.centre_deg - person.home_deg
        return cls(record.time_s, ~record.is_last, ~record.is_first, person.away(state), place)

    def at(self, away: bool) -> Bool[ndarray, " N"]:
        """Fixations at the partner or away."""
        return np.asarray(self.away == away)

    @property
    def next_away(self) -> Bool[ndarray, " N"]:
        """Whether the next fixation is away; only valid where `ended`."""
        return np.asarray(np.roll(self.away, -1))

    @property
    def next_deg(self) -> Float[ndarray, "N 2"]:
        """The next place; only valid where `ended`."""
        return np.roll(self.place_deg, -1, axis=0)

    @cached_property
    def log_durations(self) -> dict[bool, tuple[float, float, int] | None]:
        """At the partner and away: mean and standard deviation of log durations, with cuts as censoring, and number of
        ends seen; None with too few."""
        return {away: _log_durations(self, away) for away in (False, True)}


def estimate_population(people: Sequence[Person], source: str) -> GazePopulation:
    """The population of recorded people, without the correction for the tracker."""
    states, columns = {}, []
    for state in STATES:
        found = [Fixations.of(each, state) for each in people]
        own = [_own(each) for each in found]
        parameters = {}
        for name in PERSON_PARAMETERS:
            estimates = [each.get(name) for each in own]
            parameters[name] = over_people([each for each in estimates if each is not None])
            columns.append([np.nan if each is None else each.value for each in estimates])
        states[state] = StatePopulation(people=parameters, shared=_shared(found), standard_errors={})
    return GazePopulation(
        source=source, range_deg=_range_deg(people), states=states, correlation=_correlation(np.array(columns))
    )


def _range_deg(people: Sequence[Person]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest yaw and pitch of all fixations, without the outermost thousandths."""
    places = np.concatenate([Fixations.of(each, state).place_deg for each in people for state in STATES])
    low, high = np.quantile(places, [0.001, 0.999], axis=0)
    return (round(float(low[0]), 1), round(float(low[1]), 1)), (round(float(high[0]), 1), round(float(high[1]), 1))


def corrected_population(people: Sequence[Person], source: str, seed: int) -> GazePopulation:
    """The population whose gaze gives the recordings through the tracker; for `people` that are recorded.

    Standard errors are those of the recordings.
    """
    target = estimate_population(people, source)
    states = {
        state: each.model_copy(update={"standard_errors": standard_errors(people, state, seed)})
        for state, each in target.states.items()
    }
    population = target.model_copy(update={"states": states})
    for _ in range(ROUNDS):  # with the same random numbers, or it would follow the noise of each simulation
        seen = estimate_population(simulate_people(population, SIMULATED_PEOPLE, seed), source)
        population = _moved(population, target, seen)
    return population


def standard_errors(people: Sequence[Person], state: str, seed: int) -> dict[str, float]:
    """Standard errors of the standard deviations over people and of the shared parameters: bootstrap over people."""
    found = [Fixations.of(each, state) for each in people]
    own, rng = [_own(each) for each in found], np.random.default_rng(seed)
    drawn: dict[str, list[float]] = {}
    for _ in range(RESAMPLES):
        chosen = rng.integers(len(people), size=len(people))
        for name in PERSON_PARAMETERS:
            estimates = [own[index][name] for index in chosen if name in own[index]]
            if len(estimates) > 1:
                drawn.setdefault(name, []).append(over_people(estimates).sd)
        for name, value in _shared([found[index] for index in chosen]).model_dump().items():
            drawn.setdefault(name, []).append(value)
    return {name: float(np.std(values, ddof=1)) for name, values in drawn.items()}


def over_people(estimates: Sequence[Estimate]) -> PersonParameter:
    """Mean over people with its standard error, and standard deviation over people (DerSimonian & Laird 1986)."""
    value = np.array([each.value for each in estimates])
    variance = np.array([each.standard_error for each in estimates]) ** 2
    weight = 1 / variance
    fixed = weight @ value / weight.sum()
    excess = weight @ (value - fixed) ** 2 - (len(value) - 1)
    between = max(0.0, excess / (weight.sum() - (weight**2).sum() / weight.sum()))
    weight = 1 / (variance + between)
    return PersonParameter(
        mean=float(weight @ value / weight.sum()), standard_error=float(weight.sum() ** -0.5), sd=float(between**0.5)
    )


def _own(fixations: Fixations) -> dict[str, Estimate]:
    """Parameters of one person; those without enough fixations are left out."""
    found: dict[str, Estimate] = {}
    for place, away in (("partner", False), ("away", True)):
        if durations := fixations.log_durations[away]:
            mean, sd, count = durations
            found[f"log_s_{place}"] = Estimate(mean, sd / np.sqrt(count))
        ended = fixations.ended & fixations.at(away)
        if ended.sum() >= MIN_EVENTS:
            leaving = fixations.next_away[ended].sum() + 0.5
            staying = ended.sum() + 1.0 - leaving
            found["logit_stay_away" if away else "logit_leave"] = Estimate(
                float(np.log(leaving / staying)), float(np.sqrt(1 / leaving + 1 / staying))
            )
    places = fixations.place_deg[fixations.away]
    if len(places) >= MIN_EVENTS:
        # Successive places depend on each other: about a third of them count.
        independent = max(len(places) / 3, 3.0)
        for axis, name in enumerate(("yaw", "pitch")):
            spread = places[:, axis].std(ddof=1)
            found[f"away_{name}_deg"] = Estimate(float(places[:, axis].mean()), float(spread / np.sqrt(independent)))
            found[f"log_away_{name}_deg"] = Estimate(float(np.log(spread)), float(1 / np.sqrt(2 * (independent - 1))))
    return found


def _shared(found: Sequence[Fixations]) -> SharedParameters:
    """Parameters shared by all people: geometric means of the deviations within people, and steps by EM."""
    deviation = {}
    for away in (False, True):
        rows = [row for each in found if (row := each.log_durations[away])]
        deviation[away] = float(np.exp(np.average(np.log([sd for _, sd, _ in rows]), weights=[n for _, _, n in rows])))
    near = np.concatenate([each.place_deg[~each.away] for each in found])
    median, log_sd, flatness = _steps(found)
    return SharedParameters(
        log_s_sd_partner=deviation[False],
        log_s_sd_away=deviation[True],
        partner_sd_deg=float(np.sqrt((near**2).mean())),
        place_share=_return_share(found),
        step_median_deg=median,
        step_log_sd=log_sd,
        step_flatness=flatness,
    )


def _log_durations(fixations: Fixations, away: bool) -> tuple[float, float, int] | None:
    timed = fixations.onset_seen & fixations.at(away)
    ended = timed & fixations.ended
    if ended.sum() < MIN_EVENTS:
        return None
    logs = np.log(fixations.waited_s)
    mean, sd = norm.fit(CensoredData(uncensored=logs[ended], right=logs[timed & ~ended]))
    return float(mean), float(sd), int(ended.sum())


def _return_share(found: Sequence[Fixations]) -> float:
    """Share of looks away that end near one of the last places away before the present one."""
    returns = []
    for each in found:
        chosen = each.ended & each.next_away
        for index in np.flatnonzero(chosen):
            before = np.flatnonzero(each.away[:index])[-RETURN_PLACES:]
            if len(before):
                distance = np.hypot(*(each.place_deg[before] - each.next_deg[index]).T)
                returns.append(distance.min() < RETURN_DEG)
    return float(np.mean(returns))


def _steps(found: Sequence[Fixations]) -> tuple[float, float, float]:
    """Median, log deviation and flatness of looks away that are steps from the present place (EM)."""
    step, by_place = [], []
    for each in found:
        places = each.place_deg[each.away]
        chosen = each.ended & each.next_away
        if len(places) < MIN_EVENTS or not chosen.any():
            continue
        after = each.next_deg[chosen]
        step.append(after - each.place_deg[chosen])
        by_place.append(norm.pdf(after, places.mean(0), places.std(0, ddof=1)).prod(axis=1))
    steps, place_density = np.concatenate(step), np.concatenate(by_place)
    size = np.hypot(*steps.T).clip(1e-3)
    share, mean, sd = 0.5, float(np.log(5.0)), 0.8
    for _ in range(EM_STEPS):
        step_density = norm.pdf(np.log(size), mean, sd) / (2 * np.pi * size**2)
        weight = share * step_density / (share * step_density + (1 - share) * place_density)
        share = float(weight.mean())
        mean = float(weight @ np.log(size) / weight.sum())
        sd = float(np.sqrt(weight @ (np.log(size) - mean) ** 2 / weight.sum()))
    horizontal, vertical = np.sqrt(weight @ steps**2)
    return float(np.exp(mean)), sd, float(vertical / horizontal)


def _correlation(values: Float[ndarray, "K P"]) -> tuple[tuple[float, ...], ...]:
    """Shrunk correlation of parameters over people; an unknown value counts as the mean."""
    from sklearn.covariance import LedoitWolf

    centred = values - np.nanmean(values, axis=1, keepdims=True)
    scaled = np.nan_to_num(centred / np.nanstd(centred, axis=1, keepdims=True))
    covariance = LedoitWolf().fit(scaled.T).covariance_
    size = np.sqrt(np.diag(covariance))
    return tuple(tuple(round(float(each), 3) for each in row) for row in covariance / np.outer(size, size))


def _moved(population: GazePopulation, target: GazePopulation, seen: GazePopulation) -> GazePopulation:
    """Move means by their difference from the target, and standard deviations and shared parameters by their ratio."""
    states = {}
    for state, old in population.states.items():
        wanted, got = target.states[state], seen.states[state]
        people = {
            name: PersonParameter(
                mean=each.mean + wanted.people[name].mean - got.people[name].mean,
                standard_error=each.standard_error,
                sd=_moved_sd(each.sd, wanted.people[name].sd, got.people[name].sd),
            )
            for name, each in old.people.items()
        }
        shared = {
            name: value * getattr(wanted.shared, name) / getattr(got.shared, name)
            for name, value in old.shared.model_dump().items()
        }
        shared["place_share"] = min(shared["place_share"], 0.95)
        states[state] = old.model_copy(update={"people": people, "shared": SharedParameters(**shared)})
    return population.model_copy(update={"states": states})


def _moved_sd(old: float, wanted: float, got: float) -> float:
    low, high = (factor * wanted for factor in SD_FACTORS)
    return float(np.clip(old * wanted / max(got, 1e-6), low, high))


def simulate_people(population: GazePopulation, count: int, seed: int) -> list[Person]:
    """People of a population as the tracker records them: eyes alone, each state in clips of its own."""
    losses = (TRACKER.loss_per_s[0] + BLINKS_PER_S, TRACKER.loss_per_s[1] + BLINKS_PER_S)
    tracker = Tracker(loss_per_s=losses)
    people = []
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        habits = sample_habits(population, rng)
        clips = [
            simulate_clip(habits, state, CLIP_S, rng) for state in range(2) for _ in range(int(SIMULATED_S / CLIP_S))
        ]
        people.append(record_person(str(index), clips, tracker, rng))
    return people


def simulate_clip(habits: GazeHabits, state: int, seconds: float, rng: np.random.Generator) -> GazeClip:
    """Gaze of one person in one state, at the rate of the tracker; shifts take SACCADE_S."""
    how = habits.states[STATES[state]]
    times, places = [0.0], [np.zeros(2)]
    time, away = 0.0, False
    while time < seconds:
        end = time + how.dwell_s(away, rng)
        times += [end, end + SACCADE_S]
        away = how.looks_away_next(away, how.partner_share, rng)
        places += [places[-1], np.clip(how.place_deg(away, places[-1], rng), *np.array(habits.range_deg))]
        time = end + SACCADE_S
    grid = np.arange(int(seconds * CONVERSATION_RATE_HZ)) / CONVERSATION_RATE_HZ
    gaze = np.stack([np.interp(grid, times, np.array(places)[:, axis]) for axis in (0, 1)], axis=1)
    still = np.zeros(len(grid), bool)
    return GazeClip(CONVERSATION_RATE_HZ, gaze, np.full(len(grid), state), still)


def as_mapping(population: GazePopulation) -> Mapping[str, object]:
    """The population as it is written, with three digits."""

    def rounded(node: object) -> object:
        if isinstance(node, Mapping):
            return {key: rounded(each) for key, each in node.items()}
        return float(f"{node:.3g}") if isinstance(node, float) else node

    plain = population.model_dump(mode="json")
    return {**plain, "states": rounded(plain["states"])}
