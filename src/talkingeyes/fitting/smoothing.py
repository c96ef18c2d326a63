"""Temporal smoothing of fitted gaze that keeps saccades, on gaze in space.

There gaze stands still between saccades (the eyes counter-rotate the head), so it is close to piecewise constant: an
L0 gradient penalty (paper, limitation 4; Potts functional, solved exactly by dynamic programming) finds the steps.
What is left over in the fixations is smoothed by a Gaussian, the paper's temporal convolution, and added back, so
that drift and pursuit stay. A Gaussian alone would halve the peaks of saccades; none at all leaves eye speed inflated
several times.

The eyes are conjugate: their mean direction is smoothed so, their difference (vergence and the eyes' own axes) is slow.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

from talkingeyes.fitting.gaps import bridged, runs
from talkingeyes.settings import Settings

Positive = Annotated[float, Field(gt=0)]
LEAST_NOISE_RAD = np.radians(0.02)  # of the estimate, so that exact data pass unchanged
HALF_WINDOW = 7  # frames before and after, between whose medians a frame should lie


class SmoothingSettings(Settings):
    """`step_cost`: what a step costs, in variances of the frame noise; `longest_s`: of a stretch without a step.

    `fixation_s`: sigma of the Gaussian inside fixations; `vergence_s`: of the one for the difference of the eyes.
    `burst_rad`, `burst_frames`: an excursion at least so far, at most so long, that comes back is the detector's.
    """

    step_cost: Positive
    longest_s: Positive
    fixation_s: Positive
    vergence_s: Positive
    burst_rad: Positive
    burst_frames: Annotated[int, Field(ge=0, lt=HALF_WINDOW)]


def smooth_gaze(
    space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], fps: float, settings: SmoothingSettings
) -> Float[ndarray, "T 2 2"]:
    """Smoothed (yaw, pitch) of gaze in space of both eyes; frames where neither is `seen` are bridged."""
    seen = seen & ~bursts(space_rad, seen, settings)
    half = _half_difference(space_rad, seen, settings.vergence_s * fps)
    apart = np.stack([half, -half], axis=1)
    weight = seen[..., None].astype(np.float64)
    count = weight.sum(axis=1)
    version = (np.where(seen[..., None], space_rad - apart, 0.0)).sum(axis=1) / np.maximum(count, 1.0)
    known = np.asarray(seen.any(axis=1))
    if not known.any():
        return np.zeros_like(space_rad)
    version = bridged(version, known)
    steps = piecewise_constant(version, known, settings.step_cost * noise_variance(version, known), settings, fps)
    rest = _gaussian(version - steps, known, settings.fixation_s * fps)
    return np.asarray((steps + rest)[:, None] + apart)


def bursts(
    space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], settings: SmoothingSettings
) -> Bool[ndarray, "T 2"]:
    """Frames of an eye that leave the way from the median before to the median after, and soon come back.

    A saccade does not (what comes after it is where it went), and no dwell is so short.
    """
    flags = np.zeros(seen.shape, bool)
    for eye in range(2):
        known = seen[:, eye]
        track = np.pad(bridged(space_rad[:, eye], known), ((HALF_WINDOW, HALF_WINDOW), (0, 0)), mode="edge")
        windows = np.median(np.lib.stride_tricks.sliding_window_view(track, HALF_WINDOW, axis=0), axis=-1)
        frames = len(space_rad)
        before, after = windows[:frames], windows[HALF_WINDOW + 1 :]
        away = _distance_to_segment(track[HALF_WINDOW:-HALF_WINDOW], before, after) > settings.burst_rad
        for start, stop in runs(away):
            flags[start:stop, eye] = stop - start <= settings.burst_frames
    return flags


def noise_variance(track: Float[ndarray, "T 2"], known: Bool[ndarray, " T"]) -> float:
    """Variance of the frame noise per axis, from the median of absolute differences of adjacent known frames."""
    adjacent = known[1:] & known[:-1]
    if not adjacent.any():
        return float(LEAST_NOISE_RAD**2)
    sigma = 1.4826 * np.median(np.abs(np.diff(track, axis=0)[adjacent])) / np.sqrt(2)
    return float(max(sigma, LEAST_NOISE_RAD) ** 2)


def piecewise_constant(
    track: Float[ndarray, "T 2"], known: Bool[ndarray, " T"], cost: float, settings: SmoothingSettings, fps: float
) -> Float[ndarray, "T 2"]:
    """The piecewise constant path of least squared distance in known frames + `cost` a step (exact, O(T longest)).

    Dynamic programming over the last step: best(t) = min over s of best(s) + cost + scatter of frames s to t.
    """
    frames, longest = len(track), max(2, round(settings.longest_s * fps))
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


def _half_difference(
    space_rad: Float[ndarray, "T 2 2"], seen: Bool[ndarray, "T 2"], sigma: float
) -> Float[ndarray, "T 2"]:
    """Half of left minus right, heavily smoothed over frames that show both eyes."""
    both = np.asarray(seen.all(axis=1))
    if not both.any():
        return np.zeros((len(seen), 2))
    return _gaussian((space_rad[:, 0] - space_rad[:, 1]) / 2, both, sigma)


def _gaussian(values: Float[ndarray, "T C"], known: Bool[ndarray, " T"], sigma: float) -> Float[ndarray, "T C"]:
    """Gaussian smoothing over the known frames (normalised convolution); far from any, the nearest are bridged."""
    weight = gaussian_filter1d(known.astype(np.float64), sigma, mode="constant")
    total = gaussian_filter1d(np.where(known[:, None], values, 0.0), sigma, axis=0, mode="constant")
    reached = weight > 1e-6
    return bridged(total / np.maximum(weight, 1e-12)[:, None], reached)


def _distance_to_segment(
    points: Float[ndarray, "T 2"], start: Float[ndarray, "T 2"], end: Float[ndarray, "T 2"]
) -> Float[ndarray, " T"]:
    """Distance of each point to the segment from `start` to `end`."""
    along = end - start
    share = np.sum((points - start) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12)
    return np.asarray(np.linalg.norm(points - start - np.clip(share, 0, 1)[:, None] * along, axis=1))
