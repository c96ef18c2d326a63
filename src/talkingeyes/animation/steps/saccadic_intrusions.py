"""Saccadic intrusions: a fixation is interrupted by a small horizontal saccade and, soon after, one back.

Fitted motion at 25 frames a second contains no saccade below about one degree, so a model cannot learn them. Rates and
amplitudes are those of 50 healthy people (Abadi & Gowen 2004).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, fixations, shift_fixations, split_fixations

INTRUSION_STREAM = 4
MIN_FIXATION_S = 0.2
# Rate; amplitude and time until the saccade back as (mean, SD), with the observed ranges. None was vertical.
INTRUSIONS_PER_S = 18.0 / 60.0
INTRUSION_DEG, INTRUSION_RANGE_DEG = (0.6, 0.5), (0.1, 4.1)
INTRUSION_S, INTRUSION_RANGE_S = (0.225, 0.150), (0.04, 0.87)
MIN_FITTED_DEG = 1.2  # larger ones are in fitted motion, and the model learns them


def add_saccadic_intrusions(trajectory: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Add saccadic intrusions to the fixations, scaled by the liveliness of gaze. Off with `no_postprocessing`.

    A trajectory without any saccade stays still.
    """
    gain = context.controls.liveliness.gaze
    if context.controls.no_postprocessing or not trajectory.saccades or not gain:
        return trajectory
    rng = np.random.default_rng(context.stream(INTRUSION_STREAM))
    found = fixations(trajectory, trajectory.cyclopean_rad)
    room_s = np.maximum(found.end_s - found.start_s - 2.0 * MIN_FIXATION_S - INTRUSION_S[0], 0.0)
    count = rng.poisson(INTRUSIONS_PER_S * room_s.sum())
    if not count:
        return trajectory
    within = rng.choice(len(room_s), count, p=room_s / room_s.sum())
    out_s = np.sort(found.start_s[within] + MIN_FIXATION_S + rng.random(count) * room_s[within])
    last_s = found.end_s[np.searchsorted(found.start_s, out_s) - 1] - MIN_FIXATION_S
    back_s = np.minimum(out_s + _log_normal(INTRUSION_S, INTRUSION_RANGE_S, count, rng), last_s)
    free_s = np.concatenate([[-np.inf], np.maximum.accumulate(back_s)[:-1]]) + MIN_FIXATION_S
    size_deg = _log_normal(INTRUSION_DEG, INTRUSION_RANGE_DEG, count, rng) * rng.choice([-1.0, 1.0], count)
    taken = (out_s >= free_s) & (np.abs(size_deg) < MIN_FITTED_DEG)
    new = split_fixations(trajectory, [*out_s[taken], *back_s[taken]])
    out = np.isin([each.onset_s for each in new.saccades], out_s[taken])
    offsets = np.zeros((len(new.saccades) + 1, 2))
    offsets[1:][out, 0] = gain * np.radians(size_deg[taken])
    return shift_fixations(new, offsets)


def _log_normal(
    mean_and_sd: tuple[float, float], limits: tuple[float, float], count: int, rng: np.random.Generator
) -> Float[ndarray, " N"]:
    """Samples of a log-normal distribution with this mean and standard deviation, clipped to limits."""
    mean, sd = mean_and_sd
    variance = np.log1p((sd / mean) ** 2)
    return np.clip(rng.lognormal(np.log(mean) - variance / 2.0, np.sqrt(variance), count), *limits)
