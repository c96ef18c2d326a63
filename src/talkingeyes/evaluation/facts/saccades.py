"""Saccades against the main sequence: peak speed and duration by amplitude, natively and as frames show them.

Bahill, Clark & Stark 1975: peak = Vmax (1 - exp(-A / c)); Collewijn, Erkelens & Steinman 1988: duration linear in
amplitude. At 25 frames a second a five-degree saccade shows less than half its peak, so peaks are also compared one by
one with those of the same saccade at the highest rate (FACTS, sections 0g and 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.optimize import least_squares

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.detectors.saccades import ENGBERT_KLIEGL_FROM_FPS, VELOCITY, Saccades, velocity_threshold
from talkingeyes.evaluation.detectors.scoring import pair
from talkingeyes.evaluation.facts.clip import Measured, Pool, measured

LEAST_DEG = 1.0  # smaller ones are fixational, and lost at 25 frames a second
SAME_S = 0.06
BLINK_TURN_DEG, ROUND_BLINK_S = 5.0, 0.05
LEAST_SACCADES, LEAST_IN_BIN, ENOUGH_IN_BIN = 100, 4, 20


@dataclass(frozen=True)
class MainSequence:
    """The exponential law of peak speed."""

    most_deg_s: float
    constant_deg: float


def observe(behaviour: Behaviour) -> Pool:
    """Amplitudes and directions of the saccades of a clip."""
    found = behaviour.saccades
    counted = (found.amplitude_deg >= LEAST_DEG) & ~of_blinks(behaviour, found)
    return {
        "saccade.amplitude_deg": found.amplitude_deg[counted],
        "saccade.direction_rad": found.direction_rad[counted],
        "saccade.seconds": np.array([behaviour.valid.sum() / behaviour.fps]),
    }


def of_blinks(behaviour: Behaviour, found: Saccades) -> Bool[ndarray, " N"]:
    """Which are the eyes' own small turn down and in during a blink (1 to 5 degrees), which no tracker sees."""
    if behaviour.lid is None:
        return np.zeros(len(found), bool)
    blinks = behaviour.blinks
    overlaps = (found.offset_s[:, None] >= blinks.onset_s - ROUND_BLINK_S) & (
        found.onset_s[:, None] <= blinks.offset_s + ROUND_BLINK_S
    )
    return np.asarray(overlaps.any(axis=1) & (found.amplitude_deg < BLINK_TURN_DEG))


def of_rate(name: str, behaviour: Behaviour, found: Saccades) -> dict[str, ndarray]:
    """Amplitude, peak speed and duration of each saccade at one frame rate."""
    counted = ~of_blinks(behaviour, found)
    return {
        f"{name}.amplitude_deg": found.amplitude_deg[counted],
        f"{name}.peak_deg_s": found.peak_speed_deg_s[counted],
        f"{name}.duration_s": found.duration_s[counted],
    }


def rendered(behaviour: Behaviour) -> Saccades:
    """Saccades of rendered motion at any rate, by I-VT, which times them by the moments of their movement.

    It has no noise, which Engbert & Kliegl's velocity over five samples is made for; that takes a tenth off the peak of
    a small saccade, and its threshold cuts the slow start and end off, so that durations come out too short.
    """
    if behaviour.fps < ENGBERT_KLIEGL_FROM_FPS:
        return behaviour.saccades
    return velocity_threshold(behaviour.space_rad, behaviour.fps, behaviour.valid, VELOCITY)


def same(name: str, fine: Saccades, coarse: Saccades) -> dict[str, ndarray]:
    """Peaks of saccades that are found at two frame rates; amplitudes are those of the finer one."""
    pairs = pair(_middle_s(coarse), _middle_s(fine), SAME_S)
    return {
        f"{name}.amplitude_deg": fine.amplitude_deg[pairs.known],
        f"{name}.fine_deg_s": fine.peak_speed_deg_s[pairs.known],
        f"{name}.coarse_deg_s": coarse.peak_speed_deg_s[pairs.found],
    }


def _middle_s(found: Saccades) -> Float[ndarray, " N"]:
    return np.asarray((found.onset_s + found.offset_s) / 2)


def share_below(pool: Pool, limit_deg: float) -> Measured:
    """Share of amplitudes below a limit."""
    amplitude = pool["saccade.amplitude_deg"]
    return measured(
        float((amplitude < limit_deg).mean()) if len(amplitude) else np.nan, len(amplitude), "saccades", LEAST_SACCADES
    )


def mean_amplitude(pool: Pool) -> Measured:
    """Degrees."""
    amplitude = pool["saccade.amplitude_deg"]
    return measured(float(amplitude.mean()) if len(amplitude) else np.nan, len(amplitude), "saccades", LEAST_SACCADES)


def rate(pool: Pool) -> Measured:
    """Saccades of a degree or more a second."""
    amplitude, seconds = pool["saccade.amplitude_deg"], float(pool["saccade.seconds"].sum())
    return measured(len(amplitude) / max(seconds, 1e-9), len(amplitude), "saccades", LEAST_SACCADES)


def cardinal(pool: Pool) -> Measured:
    """Saccades within 22.5 degrees of left, up, right or down over those that are not."""
    sector = np.floor(pool["saccade.direction_rad"] / (np.pi / 4) + 0.5).astype(int) % 8
    level, oblique = int((sector % 2 == 0).sum()), int((sector % 2 == 1).sum())
    return measured(level / oblique if oblique else np.nan, len(sector), "saccades", LEAST_SACCADES)


def largest(pool: Pool, name: str) -> Measured:
    """The largest amplitude, degrees."""
    amplitude = pool[f"{name}.amplitude_deg"]
    return measured(float(amplitude.max()) if len(amplitude) else np.nan, len(amplitude), "saccades", LEAST_SACCADES)


def main_sequence(amplitude_deg: Float[ndarray, " N"], peak_deg_s: Float[ndarray, " N"]) -> MainSequence:
    """Fit of the exponential law to the median peak of every degree of amplitude, so that few large saccades weigh as
    much as many small ones, which alone do not tell where the law levels off."""
    bin_of = np.floor(amplitude_deg).astype(int)
    bins = [bin_of == each for each in np.unique(bin_of) if (bin_of == each).sum() >= LEAST_IN_BIN]
    x, y = (np.array([np.median(values[each]) for each in bins]) for values in (amplitude_deg, peak_deg_s))
    weight = np.sqrt(np.minimum([each.sum() for each in bins], ENOUGH_IN_BIN) / ENOUGH_IN_BIN)
    if len(x) < 5:
        return MainSequence(np.nan, np.nan)

    def left(law: ndarray) -> ndarray:
        return np.asarray(weight * (y + law[0] * np.expm1(-x / law[1])))

    found = least_squares(left, [500.0, 10.0], bounds=([50.0, 1.0], [2000.0, 60.0]), loss="soft_l1", f_scale=30.0).x
    return MainSequence(float(found[0]), float(found[1]))


def log_slope(pool: Pool, name: str, low_deg: float, high_deg: float) -> Measured:
    """Slope of log peak on log amplitude between two amplitudes, each tenth of an octave weighing the same.

    Small saccades are many times as frequent as large ones; unweighted, the slope would be theirs alone.
    """
    amplitude, peak = pool[f"{name}.amplitude_deg"], pool[f"{name}.peak_deg_s"]
    within = (amplitude >= low_deg) & (amplitude < high_deg)
    x, y = np.log2(amplitude[within]), np.log2(peak[within])
    if len(x) < LEAST_SACCADES:
        return measured(np.nan, len(x), "saccades", LEAST_SACCADES)
    bin_of = np.floor(x * 10).astype(int)
    _, index, count = np.unique(bin_of, return_inverse=True, return_counts=True)
    slope = np.polyfit(x, y, 1, w=np.sqrt(1.0 / np.maximum(count, 5)[index]))[0]
    return measured(float(slope), len(x), "saccades", LEAST_SACCADES)


def law(pool: Pool, name: str) -> dict[str, Measured]:
    """Vmax, its constant, slope and intercept of duration, and peak times duration over amplitude."""
    amplitude, peak, duration = (pool[f"{name}.{each}"] for each in ("amplitude_deg", "peak_deg_s", "duration_s"))
    count = len(amplitude)
    if count < LEAST_SACCADES:
        few = measured(np.nan, count, "saccades", LEAST_SACCADES)
        return dict.fromkeys(("most", "constant", "slope", "intercept", "shape"), few)
    sequence = main_sequence(amplitude, peak)
    line = _robust_line(amplitude, 1000 * duration)
    values = {
        "most": sequence.most_deg_s,
        "constant": sequence.constant_deg,
        "slope": line[0],
        "intercept": line[1],
        "shape": float(np.median(peak * duration / amplitude)),
    }
    return {key: measured(value, count, "saccades") for key, value in values.items()}


def _robust_line(x: Float[ndarray, " N"], y: Float[ndarray, " N"]) -> Float[ndarray, " 2"]:
    """Slope and intercept, outliers down-weighted."""
    return np.asarray(least_squares(lambda law: y - law[0] * x - law[1], [2.5, 25.0], loss="soft_l1", f_scale=5.0).x)


def peak_ratio(pool: Pool, name: str, low_deg: float, high_deg: float) -> Measured:
    """Mean share of the true peak that frames show, over saccades between two amplitudes."""
    amplitude = pool[f"{name}.amplitude_deg"]
    within = (amplitude >= low_deg) & (amplitude < high_deg)
    shown = pool[f"{name}.coarse_deg_s"][within] / pool[f"{name}.fine_deg_s"][within]
    return measured(float(shown.mean()) if len(shown) else np.nan, int(within.sum()), "saccades", 20)
