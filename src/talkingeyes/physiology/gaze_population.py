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
    # Spread of fixations at the partner, each axis.
    partner_sd_deg: float = Field(gt=0)
    # Share of looks away that are a step from the present place; the others go to one of the person's places away.
    step_share: float = Field(ge=0, le=1)
    step_median_deg: float = Field(gt=0)
    step_log_sd: float = Field(gt=0)


class StatePopulation(Settings):
    """Gaze of a population in one state."""

    people: dict[str, PersonParameter]
    shared: SharedParameters


class GazePopulation(Settings):
    """A population; `correlation` is that of the parameters over people, speaking then listening, in order."""

    source: str
    states: dict[State, StatePopulation]
    correlation: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class FixationHabits:
    """How one person fixates in one state."""

    parameters: Mapping[str, float]
    shared: SharedParameters

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
        if not away:
            return rng.normal(0.0, self.shared.partner_sd_deg, 2)
        if rng.random() < self.shared.step_share:
            size = self.shared.step_median_deg * np.exp(self.shared.step_log_sd * rng.standard_normal())
            angle = rng.uniform(0, 2 * np.pi)
            return np.asarray(present_deg + size * np.array([np.cos(angle), np.sin(angle)]))
        mean = [self.parameters["away_yaw_deg"], self.parameters["away_pitch_deg"]]
        sd = np.exp([self.parameters["log_away_yaw_deg"], self.parameters["log_away_pitch_deg"]])
        return rng.normal(mean, sd)

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
    """How one person fixates, by state."""

    states: Mapping[State, FixationHabits]


def sample_habits(population: GazePopulation, rng: np.random.Generator) -> GazeHabits:
    """Sample a person of the population."""
    root = np.linalg.cholesky(np.array(population.correlation))
    numbers = (root @ rng.standard_normal(len(root))).reshape(len(STATES), -1)
    return GazeHabits(
        {state: _habits(population.states[state], row) for state, row in zip(STATES, numbers, strict=True)}
    )


def _habits(population: StatePopulation, numbers: Float[ndarray, " K"]) -> FixationHabits:
    people = [population.people[name] for name in PERSON_PARAMETERS]
    values = [each.mean + each.sd * number for each, number in zip(people, numbers, strict=True)]
    return FixationHabits(dict(zip(PERSON_PARAMETERS, map(float, values), strict=True)), population.shared)


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
