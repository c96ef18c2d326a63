"""Main sequence of saccades: peak speed and duration by amplitude, at high frame rates and as sampled at 25 fps.

Bahill, Clark & Stark 1975: peak = Vmax (1 - exp(-A / c)). Collewijn, Erkelens & Steinman 1988: duration is linear in
amplitude. At 25 frames per second a saccade of five degrees shows less than half its peak speed, so the peak speed of
each saccade is also compared with that of the same saccade at the highest rate (Mack et al. 2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.optimize import least_squares

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.detectors.saccades import MIN_ENGBERT_KLIEGL_FPS, VELOCITY, Saccades, detect_saccades_ivt
from talkingeyes.evaluation.detectors.scoring import match_events
from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, PooledArrays, measure_values, measurement

MIN_AMPLITUDE_DEG = 1.0  # smaller ones are fixational, and not detected at 25 fps
MATCH_TOLERANCE_S = 0.06
MAX_BLINK_ROTATION_DEG, ROUND_BLINK_S = 5.0, 0.05
MIN_SACCADES, MIN_IN_BIN, ENOUGH_IN_BIN = 100, 4, 20
MAIN_SEQUENCE_RANGES = ("vmax", "main_sequence_constant", "duration_slope", "duration_intercept", "peak_shape")


@dataclass(frozen=True)
class MainSequence:
    """Parameters of the exponential main sequence of peak speed."""

    vmax_deg_s: float
    constant_deg: float


def extract(behaviour: Behaviour) -> PooledArrays:
    """Amplitudes and directions of the saccades of a clip, without small and blink-related ones."""
    found = behaviour.saccades
    counted = (found.amplitude_deg >= MIN_AMPLITUDE_DEG) & ~is_blink_related(behaviour, found)
    return {
        "saccade.amplitude_deg": found.amplitude_deg[counted],
        "saccade.direction_rad": found.direction_rad[counted],
        "saccade.seconds": np.array([behaviour.valid.sum() / behaviour.fps]),
    }


def is_blink_related(behaviour: Behaviour, found: Saccades) -> Bool[ndarray, " N"]:
    """Mask of the small downward and nasal eye rotations during blinks (1 to 5 degrees), which trackers do not see."""
    if behaviour.lid is None:
        return np.zeros(len(found), bool)
    blinks = behaviour.blinks
    overlaps = (found.offset_s[:, None] >= blinks.onset_s - ROUND_BLINK_S) & (
        found.onset_s[:, None] <= blinks.offset_s + ROUND_BLINK_S
    )
    return np.asarray(overlaps.any(axis=1) & (found.amplitude_deg < MAX_BLINK_ROTATION_DEG))


def extract_at_rate(name: str, behaviour: Behaviour, found: Saccades) -> dict[str, ndarray]:
    """Amplitude, peak speed and duration of each saccade at one frame rate."""
    counted = ~is_blink_related(behaviour, found)
    return {
        f"{name}.amplitude_deg": found.amplitude_deg[counted],
        f"{name}.peak_deg_s": found.peak_speed_deg_s[counted],
        f"{name}.duration_s": found.duration_s[counted],
    }


def detect_rendered(behaviour: Behaviour) -> Saccades:
    """Detect saccades of rendered motion at any frame rate by I-VT, with times from the moments of the movement.

    Rendered motion has no noise, so the velocity over five samples of Engbert & Kliegl is not needed. It lowers the
    peak of a small saccade by a tenth, and its threshold cuts off the slow start and end, so durations come out too
    short.
    """
    if behaviour.fps < MIN_ENGBERT_KLIEGL_FPS:
        return behaviour.saccades
    return detect_saccades_ivt(behaviour.gaze_in_space_rad, behaviour.fps, behaviour.valid, VELOCITY)


def match_frame_rates(name: str, fine: Saccades, coarse: Saccades) -> dict[str, ndarray]:
    """Peak speeds of saccades detected at two frame rates; amplitudes are those of the higher rate."""
    pairs = match_events(_middle_s(coarse), _middle_s(fine), MATCH_TOLERANCE_S)
    return {
        f"{name}.amplitude_deg": fine.amplitude_deg[pairs.known],
        f"{name}.fine_deg_s": fine.peak_speed_deg_s[pairs.known],
        f"{name}.coarse_deg_s": coarse.peak_speed_deg_s[pairs.found],
    }


def _middle_s(found: Saccades) -> Float[ndarray, " N"]:
    return np.asarray((found.onset_s + found.offset_s) / 2)


def fraction_below(pool: PooledArrays, limit_deg: float) -> Measurement:
    """Fraction of amplitudes below a limit."""
    below = pool["saccade.amplitude_deg"] < limit_deg
    return measure_values(below, np.mean, "saccades", MIN_SACCADES)


def mean_amplitude(pool: PooledArrays) -> Measurement:
    """Mean amplitude, degrees."""
    return measure_values(pool["saccade.amplitude_deg"], np.mean, "saccades", MIN_SACCADES)


def saccade_rate(pool: PooledArrays) -> Measurement:
    """Saccades of at least a degree per second of time."""
    amplitude, seconds = pool["saccade.amplitude_deg"], float(pool["saccade.seconds"].sum())
    return measurement(len(amplitude) / max(seconds, 1e-9), len(amplitude), "saccades", MIN_SACCADES)


def cardinal_ratio(pool: PooledArrays) -> Measurement:
    """Saccades within 22.5 degrees of left, up, right or down, divided by the others."""
    sector = np.floor(pool["saccade.direction_rad"] / (np.pi / 4) + 0.5).astype(int) % 8
    level, oblique = int((sector % 2 == 0).sum()), int((sector % 2 == 1).sum())
    return measurement(level / oblique if oblique else np.nan, len(sector), "saccades", MIN_SACCADES)


def largest_amplitude(pool: PooledArrays, name: str) -> Measurement:
    """The largest amplitude, degrees."""
    return measure_values(pool[f"{name}.amplitude_deg"], np.max, "saccades", MIN_SACCADES)


def main_sequence(amplitude_deg: Float[ndarray, " N"], peak_deg_s: Float[ndarray, " N"]) -> MainSequence:
    """Fit the exponential main sequence to the median peak speed in bins of one degree of amplitude.

    With bins the few large saccades weigh as much as the many small ones, which alone do not determine Vmax.
    """
    bin_of = np.floor(amplitude_deg).astype(int)
    bins = [bin_of == each for each in np.unique(bin_of) if (bin_of == each).sum() >= MIN_IN_BIN]
    x, y = (np.array([np.median(values[each]) for each in bins]) for values in (amplitude_deg, peak_deg_s))
    weight = np.sqrt(np.minimum([each.sum() for each in bins], ENOUGH_IN_BIN) / ENOUGH_IN_BIN)
    if len(x) < 5:
        return MainSequence(np.nan, np.nan)

    def left(main_sequence_model: ndarray) -> ndarray:
        return np.asarray(weight * (y + main_sequence_model[0] * np.expm1(-x / main_sequence_model[1])))

    found = least_squares(left, [500.0, 10.0], bounds=([50.0, 1.0], [2000.0, 60.0]), loss="soft_l1", f_scale=30.0).x
    return MainSequence(float(found[0]), float(found[1]))


def log_slope(pool: PooledArrays, name: str, low_deg: float, high_deg: float) -> Measurement:
    """Slope of log peak speed on log amplitude between two amplitudes, with equal weight for each tenth of an octave.

    Small saccades are much more frequent than large ones and would otherwise determine the slope alone.
    """
    amplitude, peak = pool[f"{name}.amplitude_deg"], pool[f"{name}.peak_deg_s"]
    within = (amplitude >= low_deg) & (amplitude < high_deg)
    x, y = np.log2(amplitude[within]), np.log2(peak[within])
    if len(x) < MIN_SACCADES:
        return measurement(np.nan, len(x), "saccades", MIN_SACCADES)
    bin_of = np.floor(x * 10).astype(int)
    _, index, count = np.unique(bin_of, return_inverse=True, return_counts=True)
    slope = np.polyfit(x, y, 1, w=np.sqrt(1.0 / np.maximum(count, 5)[index]))[0]
    return measurement(float(slope), len(x), "saccades", MIN_SACCADES)


def main_sequence_model(pool: PooledArrays, name: str) -> dict[str, Measurement]:
    """Vmax and constant, slope and intercept of duration, and peak speed x duration / amplitude (`peak_shape`)."""
    amplitude, peak, duration = (pool[f"{name}.{each}"] for each in ("amplitude_deg", "peak_deg_s", "duration_s"))
    count = len(amplitude)
    if count < MIN_SACCADES:
        few = measurement(np.nan, count, "saccades", MIN_SACCADES)
        return dict.fromkeys(MAIN_SEQUENCE_RANGES, few)
    sequence = main_sequence(amplitude, peak)
    line = _robust_line(amplitude, 1000 * duration)
    shape = float(np.median(peak * duration / amplitude))
    values = (sequence.vmax_deg_s, sequence.constant_deg, *line, shape)
    return {
        name: measurement(value, count, "saccades") for name, value in zip(MAIN_SEQUENCE_RANGES, values, strict=True)
    }


def _robust_line(x: Float[ndarray, " N"], y: Float[ndarray, " N"]) -> Float[ndarray, " 2"]:
    """Slope and intercept, with outliers down-weighted."""
    return np.asarray(
        least_squares(
            lambda main_sequence_model: y - main_sequence_model[0] * x - main_sequence_model[1],
            [2.5, 25.0],
            loss="soft_l1",
            f_scale=5.0,
        ).x
    )


def peak_ratio(pool: PooledArrays, name: str, low_deg: float, high_deg: float) -> Measurement:
    """Mean ratio of sampled to true peak speed, over saccades between two amplitudes."""
    amplitude = pool[f"{name}.amplitude_deg"]
    within = (amplitude >= low_deg) & (amplitude < high_deg)
    shown = pool[f"{name}.coarse_deg_s"][within] / pool[f"{name}.fine_deg_s"][within]
    return measure_values(shown, np.mean, "saccades", 20)
