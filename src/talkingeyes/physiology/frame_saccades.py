"""Saccades from frames: at 25 fps, most of them last one or two frames.

Each run of fast frame steps of gaze in space is one saccade. Its duration and shape follow the main sequence
(physiology.saccades). Its onset is estimated at sub-frame resolution from the distribution of the amplitude over the
frames.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.special import betaincinv

from talkingeyes.core.motion import Saccade
from talkingeyes.physiology import saccades

# A step of at least 1 degree per frame (25 degrees per second at 25 fps) is a saccade (Salvucci & Goldberg 2000);
# smaller steps directly before and after it are its slow start and end.
STEP_RAD = np.radians(1.0)
EDGE_RAD = np.radians(0.2)


def find_saccades(
    gaze_in_space_rad: Float[ndarray, "T 2"], fps: float, split_turns: bool = False
) -> tuple[Saccade, ...]:
    """Find saccades of gaze in space (yaw, pitch; mean of both eyes): runs of steps, with summed amplitude.

    The eye rotation of a blink turns back and sums to nothing, so it is no saccade. Gaze without blinks may be split
    where it turns back: one saccade directly after another is then two.
    """
    found = []
    step_rad = np.diff(gaze_in_space_rad, axis=0)
    steps = np.linalg.norm(step_rad, axis=1)
    for first, last in _runs(steps >= EDGE_RAD, split_turns & ((step_rad[:-1] * step_rad[1:]).sum(axis=1) < 0)):
        start, end = gaze_in_space_rad[first], gaze_in_space_rad[last + 1]
        amplitude = float(np.linalg.norm(end - start))
        if amplitude < STEP_RAD or steps[first : last + 1].max() < STEP_RAD:
            continue
        duration, skew = float(saccades.duration_s(amplitude)), float(saccades.skew(amplitude))
        found.append(
            Saccade(
                onset_s=_onset_s(gaze_in_space_rad[first : last + 2], duration, skew, first / fps, fps),
                duration_s=duration,
                start_rad=(float(start[0]), float(start[1])),
                end_rad=(float(end[0]), float(end[1])),
                skew=skew,
            )
        )
    return tuple(found)


def _onset_s(points: Float[ndarray, "K 2"], duration_s: float, skew: float, first_s: float, fps: float) -> float:
    """Onset from the completed fraction f at a frame time t1 within the saccade: t0 = t1 - D I^-1(f).

    The frame with f nearest to one half is used: there the saccade is fastest, and drift matters least.
    """
    step = points[-1] - points[0]
    shares = (points[1:-1] - points[0]) @ step / np.dot(step, step)
    within = np.flatnonzero((shares > 0) & (shares < 1))
    if not len(within):
        return first_s + max(0.5 / fps - duration_s / 2, 0.0)
    inside = int(within[np.argmin(np.abs(shares[within] - 0.5))])
    a, b = saccades.BETA_SUM * skew + 1, saccades.BETA_SUM * (1 - skew) + 1
    return max(first_s, first_s + (inside + 1) / fps - duration_s * float(betaincinv(a, b, shares[inside])))


def _runs(mask: Bool[ndarray, " T"], split: Bool[ndarray, " T-1"]) -> list[tuple[int, int]]:
    """First and last index of each run of True; runs are split between the steps of `split`."""
    starts = mask.copy()
    starts[1:] &= ~mask[:-1] | split
    ends = mask.copy()
    ends[:-1] &= ~mask[1:] | split
    return list(zip(np.flatnonzero(starts).tolist(), np.flatnonzero(ends).tolist(), strict=True))
