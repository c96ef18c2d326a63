"""Saccade kinematics in closed form, for any frame rate.

Duration is linear in amplitude. Position follows the distribution function of a Beta distribution whose skew falls with
amplitude. Peak velocities then lie on the main sequence (Bahill, Clark & Stark 1975; Collewijn, Erkelens & Steinman
1988): 116, 226 and 329 degrees per second at 2, 5 and 10 degrees. Amplitudes and directions are those of Eyes Alive
(Lee, Badler & Badler 2002). Angles are (yaw, pitch) of gaze in space in radians; times are in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.special import beta as beta_function
from scipy.special import betainc

from talkingeyes.core.motion import Saccade

INTERCEPT_S = 0.023
SLOPE_S_PER_DEG = 0.0027
BETA_SUM = 2.7
DURATION_JITTER = 0.08
PEAK_JITTER = 0.10

# Eyes Alive: percent of saccades at 0, 45, ..., 315 degrees (0 = the subject's left here, 90 = up).
DIRECTION_PERCENT = np.array([15.54, 6.46, 17.69, 7.44, 16.80, 7.89, 20.38, 7.79])
DIRECTION_JITTER_RAD = np.radians(12.0)
VERTICAL_SHRINK = 0.8
AMPLITUDE_MIN_DEG = 0.315
AMPLITUDE_MEAN_DEG = 6.9
MAX_TALKING_AMPLITUDE_DEG = 27.5


def duration_s(amplitude_rad: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """Duration of a saccade of this amplitude, seconds."""
    return np.asarray(INTERCEPT_S + SLOPE_S_PER_DEG * np.degrees(amplitude_rad))


def skew(amplitude_rad: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """Fraction of the duration spent accelerating: 0.45 up to 10 degrees, falling to 0.20 at 50."""
    return np.asarray(np.clip(0.45 - (np.degrees(amplitude_rad) - 10.0) * 0.25 / 40.0, 0.20, 0.45))


def completed_fraction(phase: Float[ndarray, "*N"], skewness: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """Completed fraction of the amplitude at `phase` (0 to 1 within the saccade, clipped outside)."""
    x = np.clip(phase, 0.0, 1.0)
    return np.asarray(betainc(BETA_SUM * np.asarray(skewness) + 1.0, BETA_SUM * (1.0 - np.asarray(skewness)) + 1.0, x))


@dataclass(frozen=True)
class Moments:
    """Mean and standard deviation of the Beta velocity profile, as fractions of the duration."""

    mean: Float[ndarray, "*N"]
    deviation: Float[ndarray, "*N"]


def progress_moments(amplitude_rad: Float[ndarray, "*N"] | float) -> Moments:
    """Moments of the velocity profile of a saccade without jitter."""
    s = skew(amplitude_rad)
    total = BETA_SUM + 2.0
    mean = (BETA_SUM * s + 1.0) / total
    return Moments(mean, np.asarray(np.sqrt(mean * (1.0 - mean) / (total + 1.0))))


def gaze_path(
    saccades: Sequence[Saccade], rest_rad: tuple[float, float] | Float[ndarray, " 2"], times_s: Float[ndarray, " T"]
) -> Float[ndarray, "T 2"]:
    """Gaze in space through a chain of saccades in order of onset; each end is held until the next onset.

    `rest_rad` is gaze if there are no saccades.
    """
    if not saccades:
        return np.tile(np.asarray(rest_rad, np.float64), (len(times_s), 1))
    onset, duration, skewness = np.array([(s.onset_s, s.duration_s, s.skew) for s in saccades]).T
    start, end = np.array([s.start_rad for s in saccades]), np.array([s.end_rad for s in saccades])
    at = saccade_progress(onset, duration, skewness, times_s)
    return np.asarray(start[at.index] + (end - start)[at.index] * at.completed[:, None])


@dataclass(frozen=True)
class SaccadeProgress:
    """At T times: index of the last saccade begun (before the first, the first), its phase, its completed fraction."""

    index: Int[ndarray, " T"]
    phase: Float[ndarray, " T"]
    completed: Float[ndarray, " T"]


def saccade_progress(
    onset_s: Float[ndarray, " K"],
    duration_s: Float[ndarray, " K"],
    skewness: Float[ndarray, " K"],
    times_s: Float[ndarray, " T"],
) -> SaccadeProgress:
    """Progress through a chain of at least one saccade, in order of onset."""
    index = np.maximum(np.searchsorted(onset_s, times_s, side="right") - 1, 0)
    phase = np.clip((times_s - onset_s[index]) / duration_s[index], 0.0, 1.0)
    completed = phase.copy()
    moving = (phase > 0.0) & (phase < 1.0)
    completed[moving] = completed_fraction(phase[moving], skewness[index[moving]])
    return SaccadeProgress(index, phase, completed)


def speed_rad_s(
    amplitude_rad: Float[ndarray, "*N"] | float, phase: Float[ndarray, "*N"] | float
) -> Float[ndarray, "*N"]:
    """Speed in radians per second at a phase of a saccade without jitter: the Beta density over the duration."""
    s = skew(amplitude_rad)
    a, b = BETA_SUM * s, BETA_SUM * (1.0 - s)
    total = beta_function(a + 1.0, b + 1.0)
    x = np.asarray(phase)
    return np.asarray(amplitude_rad / duration_s(amplitude_rad) * x**a * (1.0 - x) ** b / total)


def peak_speed(amplitude_rad: Float[ndarray, "*N"] | float) -> Float[ndarray, "*N"]:
    """The main sequence: peak speed of a saccade without jitter, in radians per second (mode of the Beta density)."""
    return speed_rad_s(amplitude_rad, skew(amplitude_rad))


def sample_saccade(
    onset_s: float, start_rad: Float[ndarray, " 2"], end_rad: Float[ndarray, " 2"], rng: np.random.Generator
) -> Saccade:
    """A saccade between two directions, with jittered duration and skew, so that peak speeds vary by about 10 %."""
    amplitude = float(np.hypot(*(end_rad - start_rad)))
    return Saccade(
        onset_s=float(onset_s),
        duration_s=float(duration_s(amplitude) * np.exp(DURATION_JITTER * rng.standard_normal())),
        start_rad=(float(start_rad[0]), float(start_rad[1])),
        end_rad=(float(end_rad[0]), float(end_rad[1])),
        skew=float(np.clip(skew(amplitude) * np.exp(PEAK_JITTER * rng.standard_normal()), 0.15, 0.6)),
    )


def sample_amplitudes_rad(
    count: int, rng: np.random.Generator, min_deg: float = 0.0, max_deg: float = MAX_TALKING_AMPLITUDE_DEG
) -> Float[ndarray, " N"]:
    """Sample amplitudes of Eyes Alive, 0.315 + Exp(6.9) degrees, truncated to two bounds (by the inverse CDF)."""
    low, high = (
        1.0 - np.exp(-max(0.0, bound - AMPLITUDE_MIN_DEG) / AMPLITUDE_MEAN_DEG) for bound in (min_deg, max_deg)
    )
    return np.asarray(np.radians(AMPLITUDE_MIN_DEG - AMPLITUDE_MEAN_DEG * np.log1p(-rng.uniform(low, high, count))))


def sample_directions(
    count: int, rng: np.random.Generator, octants: Float[ndarray, " 8"] = DIRECTION_PERCENT
) -> Float[ndarray, "N 2"]:
    """Sample unit steps; by default with Eyes Alive's directions, cardinals about twice as frequent as diagonals."""
    octant = rng.choice(8, size=count, p=octants / octants.sum())
    angle = octant * np.pi / 4 + DIRECTION_JITTER_RAD * rng.standard_normal(count)
    return np.stack([np.cos(angle), VERTICAL_SHRINK * np.sin(angle)], axis=-1)
