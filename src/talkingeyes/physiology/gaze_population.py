"""Populations of gaze: how long people fixate, when they leave and return to the partner, and where they look.

A population is a hierarchical model of fixations (semi-Markov: waiting time, then the next place), by state of the
conversation (speaking, listening) and by place (at the partner, away). Parameters of a person are normal over people,
with a covariance; others are shared by all. The estimates are in physiology/populations/NAME.yaml, with their standard
errors, their source and the command that makes them (`evaluation/people/population.py`). Angles are degrees of yaw (to
the subject's left) and pitch (up) from the partner; times in seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings, validate_section

FOLDER = Path(__file__).parent / "populations"
State = Literal["speaking", "listening"]
STATES: tuple[State, State] = ("speaking", "listening")
# Parameters of a person in a state: means of log durations at the partner and away, logits of looking away after a
# fixation there, and mean and log standard deviation of the places away.
PERSON_PARAMETERS = (
    "log_s_partner",
    "log_s_away",
    "logit_leave",
    "logit_stay_away",
    "away_yaw_deg",
    "away_pitch_deg",
    "log_away_yaw_deg",
    "log_away_pitch_deg",
)
PARTNER_RADIUS_DEG = 4.0  # as in the measures of people (evaluation/people/fixations.py)
# People go back to a few places. Number of a person's places at the partner and away, with frequencies as 1 over the
# root of the rank, and the deviation of fixations at one: choices (docs/log/2026-11-26-places.md).
PARTNER_PLACES, AWAY_PLACES, PLACE_SD_DEG = 3, 5, 0.5
ATTEMPTS = 50  # to find a place within or outside this radius


class PersonParameter(Settings):
    """Normal distribution of a parameter over people: mean, its standard error, and standard deviation."""

    mean: float
    standard_error: float = Field(ge=0)
    sd: float = Field(ge=0)


class SharedParameters(Settings):
    """Parameters of a state that all people share."""

    # Standard deviation of log durations within a person.
    log_s_sd_partner: float = Field(gt=0)
    log_s_sd_away: float = Field(gt=0)
    # Spread of the places at the partner around the most frequent one, each axis.
    partner_sd_deg: float = Field(gt=0)
    # Share of looks away that go to one of the person's places away; the others are a step from the present place.
    place_share: float = Field(ge=0, le=1)
    step_median_deg: float = Field(gt=0)
    step_log_sd: float = Field(gt=0)
    step_flatness: float = Field(gt=0)  # vertical by horizontal size of steps


class StatePopulation(Settings):
    """Gaze of a population in one state.

    `standard_errors`: of the standard deviations over people, by parameter of a person, and of the shared parameters;
    empty if they were not estimated.
    """

    people: dict[str, PersonParameter]
    shared: SharedParameters
    standard_errors: dict[str, float]


class GazePopulation(Settings):
    """A population; `correlation` is that of the parameters over people, speaking then listening, in order.

    `range_deg`: least and largest yaw and pitch, 0.1 % and 99.9 % of what was recorded.
    """

    source: str
    range_deg: tuple[tuple[float, float], tuple[float, float]]
    states: dict[State, StatePopulation]
    correlation: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class FixationHabits:
    """How one person fixates in one state."""

    parameters: Mapping[str, float]
    shared: SharedParameters
    partner_places_deg: Float[ndarray, "K 2"]
    away_places_deg: Float[ndarray, "L 2"]

    def dwell_s(self, away: bool, rng: np.random.Generator) -> float:
        """Sample the duration of a fixation."""
        mean, sd = (
            (self.parameters["log_s_away"], self.shared.log_s_sd_away)
            if away
            else (self.parameters["log_s_partner"], self.shared.log_s_sd_partner)
        )
        return float(np.exp(mean + sd * rng.standard_normal()))

    def looks_away_next(self, away: bool, partner_share: float, rng: np.random.Generator) -> bool:
        """Sample whether the next fixation is away from the partner; `partner_share` is the share of time that the
        person, in the present emotion, looks at him."""
        change = _logit(self.partner_share) - _logit(partner_share)
        logit = self.parameters["logit_stay_away" if away else "logit_leave"]
        return bool(rng.random() < _inverse_logit(logit + change))

    def place_deg(
        self, away: bool, present_deg: Float[ndarray, " 2"], rng: np.random.Generator
    ) -> Float[ndarray, " 2"]:
        """Sample the place of the next fixation."""
        for _ in range(ATTEMPTS):
            place = self._candidate(away, present_deg, rng)
            if (np.hypot(*place) > PARTNER_RADIUS_DEG) == away:
                return place
        return np.array([PARTNER_RADIUS_DEG * 1.5, 0.0]) if away else np.zeros(2)

    def _candidate(
        self, away: bool, present_deg: Float[ndarray, " 2"], rng: np.random.Generator
    ) -> Float[ndarray, " 2"]:
        if away and rng.random() >= self.shared.place_share:
            size = self.shared.step_median_deg * np.exp(self.shared.step_log_sd * rng.standard_normal())
            angle = rng.uniform(0, 2 * np.pi)
            return np.asarray(present_deg + size * np.array([np.cos(angle), self.shared.step_flatness * np.sin(angle)]))
        places = self.away_places_deg if away else self.partner_places_deg
        frequency = np.arange(1, len(places) + 1) ** -0.5
        return np.asarray(rng.normal(places[rng.choice(len(places), p=frequency / frequency.sum())], PLACE_SD_DEG))

    @property
    def partner_share(self) -> float:
        """Expected share of the time with gaze at the partner."""
        leave, stay = (_inverse_logit(self.parameters[name]) for name in ("logit_leave", "logit_stay_away"))
        away_s, partner_s = (
            np.exp(self.parameters[f"log_s_{place}"] + getattr(self.shared, f"log_s_sd_{place}") ** 2 / 2)
            for place in ("away", "partner")
        )
        partner_visits, away_visits = 1 - stay, leave
        return float(partner_visits * partner_s / (partner_visits * partner_s + away_visits * away_s))


@dataclass(frozen=True)
class GazeHabits:
    """How one person fixates, by state, and the range of the population."""

    states: Mapping[State, FixationHabits]
    range_deg: tuple[tuple[float, float], tuple[float, float]]


def sample_habits(population: GazePopulation, rng: np.random.Generator) -> GazeHabits:
    """Sample a person of the population."""
    root = np.linalg.cholesky(np.array(population.correlation))
    numbers = (root @ rng.standard_normal(len(root))).reshape(len(STATES), -1)
    face = rng.standard_normal((PARTNER_PLACES, 2))  # the same places in both states, the densest at the origin
    face[0] = 0.0
    return GazeHabits(
        {state: _habits(population.states[state], row, face, rng) for state, row in zip(STATES, numbers, strict=True)},
        population.range_deg,
    )


def _habits(
    population: StatePopulation,
    numbers: Float[ndarray, " P"],
    face: Float[ndarray, "K 2"],
    rng: np.random.Generator,
) -> FixationHabits:
    people = [population.people[name] for name in PERSON_PARAMETERS]
    values = [each.mean + each.sd * number for each, number in zip(people, numbers, strict=True)]
    own = dict(zip(PERSON_PARAMETERS, map(float, values), strict=True))
    mean, sd = (
        [own["away_yaw_deg"], own["away_pitch_deg"]],
        np.exp([own["log_away_yaw_deg"], own["log_away_pitch_deg"]]),
    )
    places = rng.normal(mean, sd, (ATTEMPTS, 2))
    away = np.hypot(*places.T) > PARTNER_RADIUS_DEG
    places = np.concatenate([places[away], places[~away]])[:AWAY_PLACES]
    return FixationHabits(own, population.shared, population.shared.partner_sd_deg * face, places)


def _logit(share: float) -> float:
    return float(np.log(share / (1 - share)))


def _inverse_logit(logit: float) -> float:
    return float(1 / (1 + np.exp(-logit)))


@lru_cache
def read_population(name: str) -> GazePopulation:
    """Read a population of the package. Raises InputError for a damaged file."""
    from ruamel.yaml import YAML

    path = FOLDER / f"{name}.yaml"
    return validate_section(str(path.name), GazePopulation, YAML(typ="safe").load(path.read_text()))
