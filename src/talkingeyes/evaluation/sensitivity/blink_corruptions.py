"""Corruptions of blinks as animation systems make them: shallow, slow, missing, by a timer.

Lid closure is split into blinks, from the frame before each detected onset to three frames after its offset, where the
lids still open, and the course between (interpolated across blinks). Only the blinks change. Strengths: corruptions.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour

SHALLOW_FACTOR = 0.5  # closure that is left
SLOW_EXTENSION = 1.0  # fraction of its duration by which a blink becomes longer
MISSING_FRACTION = 0.5
FRAMES_BEFORE, FRAMES_AFTER = 1, 3


@dataclass(frozen=True)
class BlinkClosure:
    """First frame of a blink, and the closure of both lids that it adds in its frames."""

    first: int
    closure: Float[ndarray, "F 2"]


def shallow_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Close the lids less far in every blink."""
    depth = 1 - strength * (1 - SHALLOW_FACTOR)
    return _with_blinks(motion, [replace(each, closure=depth * each.closure) for each in _blinks(motion)])


def slow_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Make every blink longer, from the same first frame on."""
    return _with_blinks(motion, [_stretched(each, 1 + strength * SLOW_EXTENSION) for each in _blinks(motion)])


def missing_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Leave out blinks at random."""
    blinks = _blinks(motion)
    kept = rng.random(len(blinks)) >= strength * MISSING_FRACTION
    return _with_blinks(motion, [blink for blink, keep in zip(blinks, kept, strict=True) if keep])


def timed_blinks(motion: Behaviour, strength: float, rng: np.random.Generator) -> Behaviour:
    """Move the blinks of a clip to equal intervals."""
    blinks = _blinks(motion)
    even = (np.arange(len(blinks)) + rng.random()) * len(motion) / max(len(blinks), 1)
    moved = [
        replace(blink, first=round(blink.first + strength * (first - blink.first)))
        for blink, first in zip(blinks, even, strict=True)
    ]
    return _with_blinks(motion, moved)


def _stretched(blink: BlinkClosure, factor: float) -> BlinkClosure:
    frames = np.arange(len(blink.closure))
    position = np.arange(round(factor * frames[-1]) + 1) / factor
    lids = [np.interp(position, frames, lid) for lid in blink.closure.T]
    return replace(blink, closure=np.stack(lids, axis=-1))


def _blinks(motion: Behaviour) -> list[BlinkClosure]:
    """The detected blinks; none without lids."""
    if motion.lid is None:
        return []
    closure = motion.lid - _without_blinks(motion)
    return [BlinkClosure(first, closure[first : last + 1]) for first, last in _frames(motion)]


def _with_blinks(motion: Behaviour, blinks: Sequence[BlinkClosure]) -> Behaviour:
    """The motion with these blinks in place of its own, the larger closure where two overlap."""
    if motion.lid is None:
        return motion
    closure = np.zeros_like(motion.lid)
    for blink in blinks:
        inside = closure[blink.first : blink.first + len(blink.closure)]
        change = blink.closure[: len(inside)]
        np.copyto(inside, change, where=np.abs(change) > np.abs(inside))
    return replace(motion, lid=_without_blinks(motion) + closure)


def _without_blinks(motion: Behaviour) -> Float[ndarray, "T 2"]:
    assert motion.lid is not None
    lid = motion.lid.copy()
    for first, last in _frames(motion):
        lid[first : last + 1] = np.linspace(motion.lid[first], motion.lid[last], last - first + 1)
    return lid


def _frames(motion: Behaviour) -> list[tuple[int, int]]:
    """First and last frame of each blink."""
    first = np.floor(motion.blinks.onset_s * motion.fps).astype(int) - FRAMES_BEFORE
    last = np.ceil(motion.blinks.offset_s * motion.fps).astype(int) + FRAMES_AFTER
    edges = np.clip(np.stack([first, last], axis=-1), 0, len(motion) - 1)
    return [(int(one), int(two)) for one, two in edges]
