"""Gaze states: gaze at the partner, or averted.

The partner is a direction in space with a radius around it, the size of a face at conversational distance. If the
direction is not given, it is the densest location of gaze: the direction with most frames within the radius, moved to
their mean (mean shift with a flat kernel). This is correct if the subject looks at the partner more than at any other
location, and wrong otherwise; docs/detectors.md reports how often. A glance shorter than `MIN_DWELL_S` does not change
the state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.signal import TimedEvents, valid_frames

RADIUS_DEG = 4.0
MIN_DWELL_S = 0.1
MAX_CANDIDATES, MAX_DIRECTIONS = 50, 2000
MEAN_SHIFT_STEPS = 3


@dataclass(frozen=True)
class GazeStates(TimedEvents):
    """N dwells in order of time; whether gaze is averted in each of T frames, and the direction of the partner.

    The clip truncates the first and the last dwell.
    """

    averted: Bool[ndarray, " T"]
    partner_rad: Float[ndarray, " 2"]
    dwell_averted: Bool[ndarray, " N"]


def detect_gaze_states(
    gaze_in_space_rad: Float[ndarray, "T 2"],
    fps: float,
    partner_rad: Float[ndarray, " 2"] | None = None,
    radius_deg: float = RADIUS_DEG,
    valid: Bool[ndarray, " T"] | None = None,
) -> GazeStates:
    """Detect the gaze state of every frame; invalid frames keep the previous state. Raises InputError."""
    known = valid_frames("gaze in space", gaze_in_space_rad, fps, valid)
    radius = np.radians(radius_deg)
    partner = densest_direction(gaze_in_space_rad[known], radius) if partner_rad is None else np.asarray(partner_rad)
    with np.errstate(invalid="ignore"):
        off = ((gaze_in_space_rad - partner) ** 2).sum(axis=1) > radius**2
    averted = steady_states(off, known, fps)
    change = np.concatenate([[0], np.flatnonzero(np.diff(averted)) + 1, [len(averted)]])
    return GazeStates(change[:-1] / fps, change[1:] / fps, averted, partner, averted[change[:-1]])


def steady_states(averted: Bool[ndarray, " T"], known: Bool[ndarray, " T"], fps: float) -> Bool[ndarray, " T"]:
    """The state of every frame: unknown frames, and runs shorter than MIN_DWELL_S, keep the previous state."""
    index = np.maximum.accumulate(np.where(known, np.arange(len(averted)), 0))
    return _steady(averted[index], max(1, round(MIN_DWELL_S * fps)))


def densest_direction(directions_rad: Float[ndarray, "K 2"], radius_rad: float) -> Float[ndarray, " 2"]:
    """The direction with most directions within the radius, moved to their mean by mean shift."""
    if not len(directions_rad):
        return np.zeros(2)
    candidates, places = (
        directions_rad[:: max(1, len(directions_rad) // most)] for most in (MAX_CANDIDATES, MAX_DIRECTIONS)
    )
    square = (candidates**2).sum(axis=1)[:, None] + (places**2).sum(axis=1) - 2.0 * candidates @ places.T
    centre = candidates[(square <= radius_rad**2).sum(axis=1).argmax()]
    for _ in range(MEAN_SHIFT_STEPS):
        centre = places[((places - centre) ** 2).sum(axis=1) <= radius_rad**2].mean(axis=0)
    return np.asarray(centre)


def _steady(flags: Bool[ndarray, " T"], least: int) -> Bool[ndarray, " T"]:
    """Give runs shorter than `least` frames the state before them."""
    change = np.concatenate([[0], np.flatnonzero(np.diff(flags)) + 1])
    lengths = np.diff(np.concatenate([change, [len(flags)]]))
    kept = lengths >= least
    kept[0] = True
    state = flags[change][np.maximum.accumulate(np.where(kept, np.arange(len(change)), 0))]
    return np.asarray(np.repeat(state, lengths))
