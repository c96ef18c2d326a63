"""Frames of a model become events, so that they play at any frame rate with saccades as fast as real ones.

A model's frames (25 a second) hold steps of gaze in space. Each step is taken for a saccade whose duration and course
follow the main sequence (physiology.saccades), its onset placed inside the frames by how the step is split among them;
between saccades gaze follows the frames. The head is a cubic spline, the eyes make up for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.interpolate import CubicSpline
from scipy.special import betaincinv

from talkingeyes import rotation
from talkingeyes.motion import Saccade
from talkingeyes.physiology import saccades

# A step of at least 1 degree a frame (25 degrees a second at 25 fps) is a saccade (Salvucci & Goldberg 2000); smaller
# steps right before and after it are its slow start and end.
STEP_RAD = np.radians(1.0)
EDGE_RAD = np.radians(0.2)


@dataclass(frozen=True)
class Performed:
    """Head and eye-in-head rotation vectors of T frames."""

    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]


def find_saccades(space_rad: Float[ndarray, "T 2"], fps: float) -> tuple[Saccade, ...]:
    """Saccades of gaze in space (yaw, pitch; the mean of the eyes): runs of steps, amplitude their sum."""
    found = []
    steps = np.linalg.norm(np.diff(space_rad, axis=0), axis=1)
    for first, last in _runs(steps >= EDGE_RAD):
        start, end = space_rad[first], space_rad[last + 1]
        amplitude = float(np.linalg.norm(end - start))
        if amplitude < STEP_RAD or steps[first : last + 1].max() < STEP_RAD:
            continue
        duration, skew = float(saccades.duration_s(amplitude)), float(saccades.skew(amplitude))
        found.append(
            Saccade(
                onset_s=_onset_s(space_rad[first : last + 2], duration, skew, first / fps, fps),
                duration_s=duration,
                start_rad=(float(start[0]), float(start[1])),
                end_rad=(float(end[0]), float(end[1])),
                skew=skew,
            )
        )
    return tuple(found)


def resample(
    head: Float[ndarray, "T 3"],
    space_rad: Float[ndarray, "T 2 2"],
    found: tuple[Saccade, ...],
    fps: float,
    new_fps: float,
) -> Performed:
    """The same motion at another frame rate. Its duration stays, so T becomes T * new_fps / fps."""
    times = np.arange(len(head)) / fps
    new_times = np.arange(int(len(head) * new_fps / fps + 1e-9)) / new_fps
    # A single frame has no spline; it is held.
    new_head = (
        CubicSpline(times, head)(np.minimum(new_times, times[-1])) if len(head) > 1 else head[new_times.astype(int)]
    )
    smooth = space_rad - staircase(found, times)[:, None]
    between = np.stack(
        [np.interp(new_times, times, smooth[:, eye, axis]) for eye in (0, 1) for axis in (0, 1)], axis=-1
    ).reshape(-1, 2, 2)
    new_space = between + staircase(found, new_times)[:, None]
    return Performed(new_head, rotation.eye_in_head(new_head, new_space))


def staircase(found: Sequence[Saccade], times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    """The sum of what all saccades have added until each time."""
    moving, landed = np.zeros((len(times_s), 2)), np.zeros((len(times_s) + 1, 2))
    for each in found:
        near = slice(*np.searchsorted(times_s, [each.onset_s, each.onset_s + each.duration_s]))
        step = np.subtract(each.end_rad, each.start_rad)
        done = saccades.progress((times_s[near] - each.onset_s) / each.duration_s, each.skew)
        moving[near] += step * done[:, None]
        landed[near.stop] += step
    return np.asarray(moving + np.cumsum(landed[:-1], axis=0))


def _onset_s(points: Float[ndarray, "K 2"], duration_s: float, skew: float, first_s: float, fps: float) -> float:
    """When the saccade starts: by the share f that the first step makes up, t0 = t1 - D I^-1(f)."""
    step = points[-1] - points[0]
    share = float(np.dot(points[1] - points[0], step) / np.dot(step, step))
    if len(points) == 2 or not 0 < share < 1:
        return first_s + max(0.5 / fps - duration_s / 2, 0.0)
    phase = float(betaincinv(saccades.BETA_SUM * skew + 1, saccades.BETA_SUM * (1 - skew) + 1, share))
    return max(first_s, first_s + 1 / fps - duration_s * phase)


def _runs(mask: Bool[ndarray, " T"]) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
