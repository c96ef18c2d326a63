"""Resample head and gaze so that saccades have natural speed at any frame rate.

A model's frames (25 a second) contain steps of gaze in space. Each step is a saccade (`physiology/frame_saccades.py`)
whose duration and velocity profile follow the main sequence; between saccades gaze is interpolated. The head is a cubic
spline; the eyes compensate for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

from talkingeyes.core import rotation
from talkingeyes.core.motion import Saccade
from talkingeyes.physiology import saccades


@dataclass(frozen=True)
class HeadAndGaze:
    """Head and eye-in-head rotation vectors of T frames."""

    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]


def resample(
    head: Float[ndarray, "T 3"],
    gaze_in_space_rad: Float[ndarray, "T 2 2"],
    found: tuple[Saccade, ...],
    fps: float,
    new_fps: float,
) -> HeadAndGaze:
    """Resample head and gaze to another frame rate; T becomes T * new_fps / fps."""
    times = np.arange(len(head)) / fps
    new_times = np.arange(int(len(head) * new_fps / fps + 1e-9)) / new_fps
    # A single frame has no spline; it is held.
    new_head = (
        CubicSpline(times, head)(np.minimum(new_times, times[-1])) if len(head) > 1 else head[new_times.astype(int)]
    )
    smooth = gaze_in_space_rad - saccade_staircase(found, times)[:, None]
    between = np.stack(
        [np.interp(new_times, times, smooth[:, eye, axis]) for eye in (0, 1) for axis in (0, 1)], axis=-1
    ).reshape(-1, 2, 2)
    new_space = between + saccade_staircase(found, new_times)[:, None]
    return HeadAndGaze(new_head, rotation.eye_in_head(new_head, new_space))


def saccade_staircase(found: Sequence[Saccade], times_s: Float[ndarray, " T"]) -> Float[ndarray, "T 2"]:
    """The sum of the displacements of all saccades up to each time."""
    moving, landed = np.zeros((len(times_s), 2)), np.zeros((len(times_s) + 1, 2))
    for each in found:
        near = slice(*np.searchsorted(times_s, [each.onset_s, each.onset_s + each.duration_s]))
        step = np.subtract(each.end_rad, each.start_rad)
        done = saccades.completed_fraction((times_s[near] - each.onset_s) / each.duration_s, each.skew)
        moving[near] += step * done[:, None]
        landed[near.stop] += step
    return np.asarray(moving + np.cumsum(landed[:-1], axis=0))
