"""Gaps in tracks: linear interpolation, or holding the last known frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray


def interpolate_gaps(values: Float[ndarray, "T C"], known: Bool[ndarray, " T"]) -> Float[ndarray, "T C"]:
    """Fill unknown frames by linear interpolation, or the nearest known frame at the ends; 0 if none is known."""
    if not known.any():
        return np.zeros_like(values)
    frames = np.arange(len(values))
    columns = [np.interp(frames, frames[known], column[known]) for column in values.T]
    return np.stack(columns, axis=-1)


def hold_last(values: Float[ndarray, "T ..."], known: Bool[ndarray, " T"]) -> Float[ndarray, "T ..."]:
    """Fill unknown frames with the last known one; frames before the first known one with that."""
    return np.asarray(values[last_known(known)]) if known.any() else values


def last_known(known: Bool[ndarray, " T"]) -> Int[ndarray, " T"]:
    """Index of the last known frame at or before each frame; before the first known frame, its index."""
    index = np.where(known, np.arange(len(known)), -1)
    return np.where(np.maximum.accumulate(index) < 0, int(np.argmax(known)), np.maximum.accumulate(index))


def runs(flags: Bool[ndarray, " T"]) -> list[tuple[int, int]]:
    """Runs of True as (start, stop)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
