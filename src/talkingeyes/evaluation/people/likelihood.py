"""Likelihood of recorded fixations under simple marked point processes: nats per fixation on people left out.

An event is a shift of gaze: its waiting time since the onset of the fixation that it ends, and the place of the next
fixation relative to home (density per square degree). Fixations that a segment cuts count with the time in which no
shift came. Both models are conditioned on the state; people weigh the same in fitting and in scores.

`PoissonGaussian`: a constant rate, and places from one Gaussian. `EmpiricalHistogram`: hazards by time since the last
shift, at the partner and away, in bins; places from a mixture of a histogram of places, at the partner and away, and a
histogram of steps from the present place, both smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter
from scipy.stats import multivariate_normal

from talkingeyes.evaluation.people.fixations import Person

HAZARD_EDGES_S = (0.0, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, np.inf)
HALF_EXTENT_DEG, BIN_DEG = 80.0, 1.0  # of the histograms; steps reach twice as far as places
SMOOTHING_DEG = (1.0, 4.0)  # two widths, in equal parts
FLOOR = 1e-3  # share of a uniform density
EM_STEPS = 30
MIN_VARIANCE_DEG2 = 0.25


@dataclass(frozen=True)
class Shifts:
    """N fixations of several people in one state; `ended` marks those that a seen shift ends."""

    waited_s: Float[ndarray, " N"]
    ended: Bool[ndarray, " N"]
    away: Bool[ndarray, " N"]
    place_deg: Float[ndarray, "N 2"]
    next_deg: Float[ndarray, "N 2"]  # of the next fixation, 0 where not seen
    weight: Float[ndarray, " N"]  # of a person's fixations: 1 / its seen shifts

    @classmethod
    def of(cls, people: Sequence[Person], state: str) -> Shifts:
        """The shifts of the people that have one in the state."""
        parts = []
        for person in people:
            record = person.records[state]
            if not len(record) or not record.continues.any():
                continue
            place = record.centre_deg - person.home_deg
            ended = ~record.is_last
            after = np.where(ended[:, None], np.concatenate([place[1:], place[:1]]), 0.0)
            weight = np.full(len(record), 1 / ended.sum())
            parts.append((record.time_s, ended, person.away(state), place, after, weight))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True)
class PoissonGaussian:
    """A constant rate per second, and a Gaussian of places."""

    rate: float
    mean: Float[ndarray, " 2"]
    covariance: Float[ndarray, "2 2"]

    @classmethod
    def fit(cls, shifts: Shifts) -> PoissonGaussian:
        """Maximum likelihood."""
        weight, after = shifts.weight[shifts.ended], shifts.next_deg[shifts.ended]
        rate = weight.sum() / (shifts.weight @ shifts.waited_s)
        covariance = np.cov(after.T, aweights=weight) + MIN_VARIANCE_DEG2 * np.eye(2)
        return cls(float(rate), np.average(after, axis=0, weights=weight), covariance)

    def log_likelihood(self, shifts: Shifts) -> Float[ndarray, " N"]:
        """Log-likelihood of each fixation."""
        places = multivariate_normal(self.mean, self.covariance).logpdf(shifts.next_deg)
        return np.asarray(np.where(shifts.ended, np.log(self.rate) + places, 0.0) - self.rate * shifts.waited_s)


@dataclass(frozen=True)
class EmpiricalHistogram:
    """Hazards per second by bin and place (partner, away); histograms of places and of steps; their mixture."""

    hazards: Float[ndarray, "2 B"]
    places: Float[ndarray, "2 K K"]
    steps: Float[ndarray, "K K"]
    place_share: float

    @classmethod
    def fit(cls, shifts: Shifts) -> EmpiricalHistogram:
        """Counts, and expectation maximisation for the share of the histogram of places."""
        hazards = np.stack([_hazards(shifts, shifts.away == away) for away in (False, True)])
        seen = shifts.ended
        places = np.stack(
            [
                _histogram(shifts.next_deg[chosen], shifts.weight[chosen])
                for chosen in (seen & ~shifts.away, seen & shifts.away)
            ]
        )
        steps = _histogram((shifts.next_deg - shifts.place_deg)[seen], shifts.weight[seen])
        share = 0.5
        model = cls(hazards, places, steps, share)
        by_place, by_step = model._densities(shifts)
        for _ in range(EM_STEPS):
            responsibility = share * by_place / (share * by_place + (1 - share) * by_step)
            share = float(np.average(responsibility[seen], weights=shifts.weight[seen]))
        return cls(hazards, places, steps, share)

    def _densities(self, shifts: Shifts) -> tuple[Float[ndarray, " N"], Float[ndarray, " N"]]:
        row, column = _cells(shifts.next_deg).T
        by_place = self.places[shifts.away.astype(int), row, column]
        row, column = _cells(shifts.next_deg - shifts.place_deg).T
        return by_place, self.steps[row, column]

    def log_likelihood(self, shifts: Shifts) -> Float[ndarray, " N"]:
        """Log-likelihood of each fixation."""
        by_place, by_step = self._densities(shifts)
        density = self.place_share * by_place + (1 - self.place_share) * by_step
        hazard = self.hazards[shifts.away.astype(int)]
        at = np.searchsorted(HAZARD_EDGES_S, shifts.waited_s, side="right") - 1
        rate = hazard[np.arange(len(at)), at]
        survived = (hazard * _exposures(shifts.waited_s)).sum(axis=1)
        return np.asarray(np.where(shifts.ended, np.log(rate) + np.log(density), 0.0) - survived)


ShiftModel = PoissonGaussian | EmpiricalHistogram


def score(model: ShiftModel, people: Sequence[Person], state: str) -> Float[ndarray, " P"]:
    """Nats per fixation (log-likelihood / seen shifts) of each person that has shifts."""
    found = []
    for person in people:
        if person.records[state].continues.any():
            shifts = Shifts.of([person], state)
            found.append(model.log_likelihood(shifts).sum() / shifts.ended.sum())
    return np.array(found)


def _exposures(waited_s: Float[ndarray, " N"]) -> Float[ndarray, "N B"]:
    """Time that each wait spends in each bin."""
    low, high = np.array(HAZARD_EDGES_S[:-1]), np.array(HAZARD_EDGES_S[1:])
    return np.asarray(np.clip(waited_s[:, None] - low, 0.0, high - low))


def _hazards(shifts: Shifts, chosen: Bool[ndarray, " N"]) -> Float[ndarray, " B"]:
    """Hazard in each bin, towards the overall rate by one event."""
    at = np.searchsorted(HAZARD_EDGES_S, shifts.waited_s, side="right") - 1
    ended, weight = chosen & shifts.ended, shifts.weight * shifts.ended.sum() / shifts.weight[shifts.ended].sum()
    events = np.bincount(at[ended], weight[ended], len(HAZARD_EDGES_S) - 1)
    time_s = weight[chosen] @ _exposures(shifts.waited_s[chosen])
    rate = (events.sum() + 1) / (time_s.sum() + 1)
    return np.asarray((events + 1) / (time_s + 1 / rate))


def _cells(points_deg: Float[ndarray, "N 2"]) -> Int[ndarray, "N 2"]:
    count = round(2 * HALF_EXTENT_DEG / BIN_DEG)
    return np.asarray(np.clip(np.floor((points_deg + HALF_EXTENT_DEG) / BIN_DEG).astype(int), 0, count - 1))


def _histogram(points_deg: Float[ndarray, "N 2"], weight: Float[ndarray, " N"]) -> Float[ndarray, "K K"]:
    """Smoothed density per square degree."""
    count = round(2 * HALF_EXTENT_DEG / BIN_DEG)
    counts = np.zeros((count, count))
    np.add.at(counts, tuple(_cells(points_deg).T), weight)
    smooth = sum(gaussian_filter(counts, width / BIN_DEG) for width in SMOOTHING_DEG)
    total = smooth.sum()
    uniform = np.full_like(counts, 1 / counts.size)
    mixed = (1 - FLOOR) * smooth / total + FLOOR * uniform if total > 0 else uniform
    return np.asarray(mixed / BIN_DEG**2)
