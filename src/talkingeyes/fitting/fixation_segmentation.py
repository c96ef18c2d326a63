"""Fixation segmentation: the L0 gradient term (paper, limitation 4) solved exactly, with main-sequence saccades.

A track of gaze in space is close to piecewise constant. The Potts functional,

    minimise over paths x    sum over known frames |y_t - x_t|^2  +  cost * number of steps of x

is minimised by dynamic programming. It keeps saccades steep, but makes each an instantaneous step, whereas a saccade
takes 30 to 100 ms and covers one to three frames. `insert_saccades` therefore replaces each step by a saccade of the
main sequence (`physiology.saccades`: duration and shape follow from amplitude), with the onset that fits the frames
best, at a resolution of a tenth of a frame. A step in a gap is placed at the start of the gap, because most gaze shifts
during a blink start with it (Evinger et al. 1994).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.physiology.saccades import completed_fraction, duration_s, skew

MIN_NOISE_RAD = np.radians(0.02)  # lower limit of the estimate, so that exact data pass unchanged
MIN_FIXATION_S = 0.08  # shorter segments are part of a saccade
FLANK_S = 0.12  # frames this close to a step are used to locate it
ONSETS_PER_FRAME = 10
ITERATIONS = 2  # alternating between saccade onsets and fixation levels


@dataclass(frozen=True)
class Fixation:
    """Frames from `start` up to `stop`, and the gaze direction in them."""

    start: int
    stop: int
    level_rad: Float[ndarray, " 2"]


def noise_variance(track: Float[ndarray, "T 2"], known: Bool[ndarray, " T"]) -> float:
    """Variance of the frame noise per axis, from the median absolute difference of adjacent known frames."""
    adjacent = known[1:] & known[:-1]
    if not adjacent.any():
        return float(MIN_NOISE_RAD**2)
    sigma = 1.4826 * np.median(np.abs(np.diff(track, axis=0)[adjacent])) / np.sqrt(2)
    return float(max(sigma, MIN_NOISE_RAD) ** 2)


def piecewise_constant(
    track: Float[ndarray, "T 2"], known: Bool[ndarray, " T"], cost: float, longest: int
) -> Float[ndarray, "T 2"]:
    """Minimise squared distance in known frames + `cost` per step, with segments up to `longest` frames; O(T longest).

    Dynamic programming over the last step: best(t) = min over s of best(s) + cost + scatter of frames s to t.
    """
    frames = len(track)
    weight = known.astype(np.float64)
    mass = np.concatenate([[0.0], np.cumsum(weight)])
    first = np.concatenate([np.zeros((1, 2)), np.cumsum(weight[:, None] * track, axis=0)])
    second = np.concatenate([[0.0], np.cumsum(weight * np.sum(track**2, axis=1))])
    best = np.full(frames + 1, np.inf)
    best[0] = -cost
    origin = np.zeros(frames + 1, np.int64)
    for stop in range(1, frames + 1):
        start = max(0, stop - longest)
        inside = np.maximum(mass[stop] - mass[start:stop], 1e-12)
        moment = np.sum((first[stop] - first[start:stop]) ** 2, axis=1) / inside
        total = best[start:stop] + cost + (second[stop] - second[start:stop] - moment)
        choice = int(np.argmin(total))
        best[stop], origin[stop] = total[choice], start + choice
    path, stop = np.empty_like(track), frames
    while stop > 0:
        start = origin[stop]
        path[start:stop] = (first[stop] - first[start]) / max(mass[stop] - mass[start], 1e-12)
        stop = start
    return path


def insert_saccades(
    track: Float[ndarray, "T 2"], known: Bool[ndarray, " T"], path: Float[ndarray, "T 2"], fps: float
) -> Float[ndarray, "T 2"]:
    """Replace each step of the piecewise constant `path` of `track` by a saccade. Requires at least one known frame."""
    shortest = MIN_FIXATION_S * fps
    fixations = [each for each in split_fixations(path) if known[each.start : each.stop].sum() >= shortest - 1e-9]
    if len(fixations) < 2:
        return path
    variance = noise_variance(track, known)
    for _ in range(ITERATIONS):
        rendered = np.repeat([fixations[0].level_rad], len(track), axis=0)
        still = np.ones(len(track), bool)
        for before, after in itertools.pairwise(fixations):
            done = _saccade_progress(track, known, before, after, variance, fps)
            at = len(track) - len(done)
            rendered[at:] += done[:, None] * (after.level_rad - before.level_rad)
            still[at:] &= (done < 0.01) | (done > 0.99)
        fixations = [_refine_level(track, known & still, each) for each in fixations]
    return rendered


def split_fixations(path: Float[ndarray, "T 2"]) -> list[Fixation]:
    """Constant segments of a piecewise constant path."""
    edges = np.flatnonzero(np.any(np.diff(path, axis=0) != 0.0, axis=1)) + 1
    starts, stops = [0, *edges.tolist()], [*edges.tolist(), len(path)]
    return [Fixation(start, stop, path[start]) for start, stop in zip(starts, stops, strict=True)]


def _saccade_progress(
    track: Float[ndarray, "T 2"],
    known: Bool[ndarray, " T"],
    before: Fixation,
    after: Fixation,
    variance: float,
    fps: float,
) -> Float[ndarray, " F"]:
    """Completed fraction of the saccade between two fixations over the last F frames, from just before it on."""
    last = before.start + int(np.flatnonzero(known[before.start : before.stop])[-1])
    first = after.start + int(np.flatnonzero(known[after.start : after.stop])[0])
    flank = round(FLANK_S * fps)
    start, stop = max(before.start, last - flank), min(after.stop, first + flank + 1)
    step = after.level_rad - before.level_rad
    amplitude = max(float(np.hypot(*step)), 1e-9)
    lasting = float(duration_s(amplitude)) * fps
    frames = np.arange(start, stop)
    onsets = np.arange(start - lasting, stop, 1.0 / ONSETS_PER_FRAME)
    done = completed_fraction((frames - onsets[:, None]) / lasting, float(skew(amplitude)))
    away = (track[start:stop] - before.level_rad)[None] - done[..., None] * step
    misfit = np.sum(np.square(away) * known[start:stop, None], axis=(1, 2))
    if (~known[last:first]).sum() > 1:  # a gap: all onsets in it fit equally well, so take the earliest
        onset = onsets[int(np.argmin(misfit + 1e-6 * amplitude**2 * np.maximum(onsets - last, 0.0)))]
    else:  # posterior mean: a single best onset would be arbitrary if no frame lies within the step
        likely = np.exp((misfit.min() - misfit) / (2.0 * variance))
        onset = float(likely @ onsets / likely.sum())
    return np.asarray(completed_fraction((np.arange(start, len(track)) - onset) / lasting, float(skew(amplitude))))


def _refine_level(track: Float[ndarray, "T 2"], usable: Bool[ndarray, " T"], fixation: Fixation) -> Fixation:
    """Recompute the level of a fixation from frames outside saccades, if there are any."""
    inside = usable[fixation.start : fixation.stop]
    if not inside.any():
        return fixation
    return Fixation(fixation.start, fixation.stop, track[fixation.start : fixation.stop][inside].mean(axis=0))
