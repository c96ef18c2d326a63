"""A population of eye contact: how long people look at the partner and away, and what turns do to it.

A person looks at the partner for a share of the time, in own turns and in the partner's, correlated; who has no partner
that takes turns looks as in an interview, by the share in own turns. Looks away are
log-normal; looks at the partner are log-normal with the mean that gives the person's share. Around turns, aversions
and returns are cued with a probability (synthesis/gaze_aversion.py). The estimates, their source and the command that
makes them are in physiology/populations/face_to_face.yaml. Times are in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from scipy.special import expit

from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.physiology.gaze_population import FOLDER

ContactState = Literal["speaking", "listening", "interview"]
SHARES = (0.05, 0.95)  # bounds of a person's shares of gaze at the partner


class StateContact(Settings):
    """Looks in a state of the conversation, or in an interview."""

    # Logit of a person's share of the time with gaze at the partner: mean and standard deviation over people.
    logit_share: float
    logit_share_sd: float = Field(ge=0)
    # Median look away of an average person, and standard deviation of log durations within a person.
    away_s: float = Field(gt=0)
    away_log_sd: float = Field(gt=0)
    look_log_sd: float = Field(gt=0)
    # Factor on the mean look at the partner that makes up for looks that cues cut short or lengthen.
    look_scale: float = Field(gt=0)


class ContactCues(Settings):
    """Probabilities of cues of a person whose gaze follows speech fully, and their timing (mean, SD; or a range).

    `planning`: an aversion around the start of an utterance after a pause; `floor`: after a short one; both less likely
    for what is short beside `planned_s`, the time constant over what is left of the turn. `turn_end`: a
    return to the partner around the end of an utterance before a pause; `pause`: before a short one.
    """

    planning: float = Field(ge=0, le=1)
    floor: float = Field(ge=0, le=1)
    turn_end: float = Field(ge=0, le=1)
    pause: float = Field(ge=0, le=1)
    planned_s: float = Field(gt=0)
    aversion_start_s: tuple[float, float]
    aversion_end_s: tuple[float, float]
    return_s: tuple[float, float]


class ContactPopulation(Settings):
    """A population. `share_correlation` is that of a person's two shares, `dwell_log_sd` the spread of all durations
    over people."""

    source: str
    states: dict[ContactState, StateContact]
    share_correlation: float = Field(ge=-1, le=1)
    dwell_log_sd: float = Field(ge=0)
    cues: ContactCues


@dataclass(frozen=True)
class ContactHabits:
    """How much one person looks at the partner, by state, and a factor on the duration of looks."""

    share_speaking: float
    share_listening: float
    dwell_scale: float


def contact_habits(population: ContactPopulation, normal: Float[ndarray, " 3"]) -> ContactHabits:
    """The person that three standard normal numbers stand for."""
    first, second, dwell = normal
    correlation = population.share_correlation
    numbers = first, correlation * first + np.sqrt(1 - correlation**2) * second
    laws = population.states["speaking"], population.states["listening"]
    speaking, listening = (
        float(np.clip(expit(law.logit_share + law.logit_share_sd * number), *SHARES))
        for law, number in zip(laws, numbers, strict=True)
    )
    return ContactHabits(speaking, listening, float(np.exp(population.dwell_log_sd * dwell)))


@cache
def read_contact(name: str) -> ContactPopulation:
    """Read a population of the package. Raises InputError for a damaged file."""
    from ruamel.yaml import YAML

    path = FOLDER / f"{name}.yaml"
    return validate_section(path.name, ContactPopulation, YAML(typ="safe").load(path.read_text()))
