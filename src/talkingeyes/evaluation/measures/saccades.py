"""Saccades of gaze in space (rate, amplitude, direction, main sequence, duration) and fixations.

Peak speeds are compared with the main sequence as sampled at the frame rate of the motion: at 25 frames per second a
saccade of five degrees shows less than half its true peak speed (Mack et al. 2017), so the truth would not follow the
continuous main sequence. Sources: Bahill, Clark & Stark 1975; Lee, Badler & Badler 2002; Salvucci & Goldberg 2000.
Directions: sector 0 is the subject's left, 2 up, 4 right, 6 down.

The benchmark counts all saccades that the detector finds. The reference ranges pool those of at least a degree that are
not of a blink, and fit the main sequence at high frame rates: peak = Vmax (1 - exp(-A / c)) (Bahill et al.), duration
linear in amplitude (Collewijn, Erkelens & Steinman 1988); and compare peaks with those of the same saccades at 25 fps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.detectors.saccades import (
    MIN_DURATION_FPS,
    MIN_ENGBERT_KLIEGL_FPS,
    VELOCITY,
    Saccades,
    detect_saccades_ivt,
)
from talkingeyes.evaluation.detectors.scoring import match_events
from talkingeyes.evaluation.measures.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide, variation
from talkingeyes.evaluation.measures.pooled import Measurement, PooledArrays, measure_values, measurement
from talkingeyes.physiology import saccades as physiology

AMPLITUDE_DEG = Bins(0.0, 40.0, 80)
INTERVAL_S = Bins(0.0, 6.0, 120)
SECTORS = 8
# Smaller saccades are near the noise of trackers and are not compared with the main sequence.
MAIN_SEQUENCE_MIN_DEG = 2.0
MAIN_SEQUENCE_GRID_DEG = np.arange(1.0, 46.0)
SAMPLING_PHASES = 40
LEE = "Lee, Badler & Badler 2002 (Eyes Alive)"


@lru_cache(maxsize=8)
def sampled_log_peak_speed(fps: float) -> Float[ndarray, " A"]:
    """Log of the peak speed (degrees per second) of sampled saccades, for the amplitudes MAIN_SEQUENCE_GRID_DEG.

    The sampled peak speed is the largest step between frames times the frame rate; its logarithm is averaged over the
    phase of the frames.
    """
    amplitude = np.radians(MAIN_SEQUENCE_GRID_DEG)[:, None, None]
    duration = physiology.duration_s(amplitude)
    frames = int(np.ceil(float(duration.max()) * fps)) + 2
    times_s = (
        np.arange(frames)[None, None] - 1 + (np.arange(SAMPLING_PHASES)[None, :, None] + 0.5) / SAMPLING_PHASES
    ) / fps
    phase, skewness = np.broadcast_arrays(times_s / duration, physiology.skew(amplitude))
    done = physiology.completed_fraction(phase, skewness)
    peak = np.degrees(amplitude[..., 0]) * np.diff(done, axis=2).max(axis=2) * fps
    return np.asarray(np.log(peak).mean(axis=1))


def extract(behaviour: Behaviour) -> Sums:
    """Counts, histograms and sums over the saccades and fixations of a clip."""
    found, fps = behaviour.saccades, behaviour.fps
    amplitude, duration, direction = found.amplitude_deg, found.duration_s, found.direction_rad
    timed = np.full(len(found), fps >= MIN_DURATION_FPS)  # below, frames are too long for durations
    interval = np.diff(found.onset_s)
    rest = found.onset_s[1:] - found.offset_s[:-1]
    sector = np.floor(direction / (2 * np.pi / SECTORS) + 0.5).astype(int) % SECTORS
    large = amplitude >= MAIN_SEQUENCE_MIN_DEG
    log_amplitude = np.log(amplitude[large])
    excess = np.log(found.peak_speed_deg_s[large]) - np.interp(
        amplitude[large], MAIN_SEQUENCE_GRID_DEG, sampled_log_peak_speed(fps)
    )
    return {
        "saccade.saccades": len(amplitude),
        "saccade.seconds": behaviour.valid.sum() / fps,
        "saccade.amplitude_deg": amplitude.sum(),
        "saccade.timed_saccades": timed.sum(),
        "saccade.duration_s": duration[timed].sum(),
        "saccade.intervals": len(interval),
        "saccade.interval_s": interval.sum(),
        "saccade.interval_s2": np.square(interval).sum(),
        "law.saccades": large.sum(),
        "law.excess": excess.sum(),
        "law.excess2": np.square(excess).sum(),
        "law.amplitude": log_amplitude.sum(),
        "law.amplitude2": np.square(log_amplitude).sum(),
        "law.product": (log_amplitude * excess).sum(),
        "saccade.amplitude": AMPLITUDE_DEG(amplitude),
        "saccade.sector": np.bincount(sector, minlength=SECTORS),
        "saccade.interval": INTERVAL_S(interval),
        "saccade.fixation": INTERVAL_S(rest),
    }


OBSERVER = Extractor(extract, ("head", "gaze"))


def _cardinal(totals: Totals) -> Float[ndarray, " D"]:
    sector = totals["saccade.sector"]
    return safe_divide(sector[:, ::2].sum(axis=1), sector[:, 1::2].sum(axis=1))


def _towards(first: int) -> Float[ndarray, " S"]:
    """Signs of the sectors: 1 for `first` and its neighbours, -1 for the opposite three, 0 for the other two."""
    return np.roll([1.0, 1.0, 0.0, -1.0, -1.0, -1.0, 0.0, 1.0], first)


def _asymmetry(first: int) -> Callable[[Totals], Float[ndarray, " D"]]:
    sign = _towards(first)
    return lambda totals: safe_divide(totals["saccade.sector"] @ sign, totals["saccade.sector"] @ np.abs(sign))


def _log_spread(totals: Totals) -> Float[ndarray, " D"]:
    mean = safe_divide(totals["law.excess"], totals["law.saccades"])
    square = safe_divide(totals["law.excess2"], totals["law.saccades"])
    return np.asarray(np.sqrt(np.maximum(square - mean**2, 0)))


def _law_slope(totals: Totals) -> Float[ndarray, " D"]:
    count, x, y = (totals[f"law.{name}"] for name in ("saccades", "amplitude", "excess"))
    return safe_divide(count * totals["law.product"] - x * y, count * totals["law.amplitude2"] - x**2)


_measure = partial(Metric, extractor=OBSERVER, count_key="saccade.saccades", source=LEE)
_law = partial(Metric, extractor=OBSERVER, count_key="law.saccades", min_count=100)
_interval = partial(Metric, extractor=OBSERVER, count_key="saccade.intervals", min_count=100, rate_dependent=True)

METRICS = (
    _measure(
        "saccades/rate",
        "saccade rate",
        "1/s",
        "number of saccades / seconds of valid frames",
        compute=ratio("saccade.saccades", "saccade.seconds"),
        min_count=30,
        rate_dependent=True,
        caveat=(
            "jitter above the detector's threshold counts as saccades; at 25 frames per second saccades under 1 "
            "degree are missed"
        ),
    ),
    _measure(
        "saccades/amplitude",
        "mean amplitude",
        "deg",
        "mean angle between gaze before and after a saccade",
        compute=ratio("saccade.amplitude_deg", "saccade.saccades"),
        min_count=50,
        caveat=(
            "two saccades within two frames count as one; a mix of few very large and many very small saccades "
            "can have the right mean"
        ),
    ),
    _measure(
        "saccades/amplitude_median",
        "median amplitude",
        "deg",
        "median of the amplitudes (half-degree bins)",
        compute=lambda totals: AMPLITUDE_DEG.quantile(totals["saccade.amplitude"], 0.5),
        min_count=100,
        caveat="depends on the detector's threshold, which excludes the smallest saccades",
    ),
    _measure(
        "saccades/amplitude_p90",
        "90th percentile of amplitude",
        "deg",
        "90th percentile of the amplitudes (half-degree bins)",
        compute=lambda totals: AMPLITUDE_DEG.quantile(totals["saccade.amplitude"], 0.9),
        min_count=100,
        caveat="determined by few events",
    ),
    _measure(
        "saccades/below_5",
        "P(A < 5 deg)",
        "fraction",
        "fraction of amplitudes below 5 degrees",
        compute=lambda totals: AMPLITUDE_DEG.fraction_below(totals["saccade.amplitude"], 5.0),
        min_count=100,
        source=f"{LEE}; Malinov et al. 2000 (0.53)",
        caveat="raised by noise that is detected as saccades",
    ),
    _measure(
        "saccades/below_15",
        "P(A < 15 deg)",
        "fraction",
        "fraction of amplitudes below 15 degrees",
        compute=lambda totals: AMPLITUDE_DEG.fraction_below(totals["saccade.amplitude"], 15.0),
        min_count=100,
        source="Bahill, Adler & Stark 1975 (0.86)",
        caveat="near 1 for any motion with small saccades",
    ),
    _measure(
        "saccades/amplitude_distance",
        "amplitudes, Wasserstein",
        "SD of truth",
        "area between the two distribution functions of amplitude / SD of the reference's",
        compare=lambda totals, other: AMPLITUDE_DEG.distance(totals["saccade.amplitude"], other["saccade.amplitude"]),
        min_count=100,
        direction="lower",
        source="Kantorovich 1942",
        caveat="never 0 in a finite sample: compare with the distance between halves of the reference",
    ),
    _measure(
        "saccades/cardinal_ratio",
        "cardinal / diagonal saccades",
        "ratio",
        "saccades in the 4 cardinal sectors of 45 deg / saccades in the 4 diagonal sectors",
        compute=_cardinal,
        min_count=200,
        caveat="a low vertical gain turns diagonal saccades into horizontal ones",
    ),
    _measure(
        "saccades/left_right_asymmetry",
        "left-right asymmetry",
        "fraction",
        "(leftward - rightward) / (leftward + rightward) saccades, within 67.5 deg of the subject's left and right",
        compute=_asymmetry(0),
        min_count=200,
        caveat=(
            "near 0 in a symmetric population, so it does not detect mirroring unless individuals prefer one side: see"
            " reference_correlation/aversion_yaw"
        ),
    ),
    _measure(
        "saccades/up_down_asymmetry",
        "up-down asymmetry",
        "fraction",
        "(upward - downward) / (upward + downward) saccades, within 67.5 deg of up and down",
        compute=_asymmetry(2),
        min_count=200,
        caveat="always small, since gaze returns after leaving; see eye/pitch_skew",
    ),
    _law(
        "main_sequence/peak_speed_ratio",
        "peak speed / sampled main sequence",
        "ratio",
        (
            "exp mean log (peak speed / peak speed of the Beta velocity profile at that amplitude, sampled at this "
            "frame rate); A >= 2 deg"
        ),
        compute=lambda totals: np.exp(safe_divide(totals["law.excess"], totals["law.saccades"])),
        source="Bahill, Clark & Stark 1975; Mack et al. 2017",
        caveat="relative to the continuous main sequence even the truth is at 0.47 (5 deg, 25 frames per second)",
    ),
    _law(
        "main_sequence/slope",
        "slope relative to the main sequence",
        "log/log",
        "slope of log (peak speed / sampled main sequence) on log amplitude; 0 on the main sequence",
        compute=_law_slope,
        source="Bahill, Clark & Stark 1975",
        caveat="naive upsampling preserves amplitudes but changes the slope",
    ),
    _law(
        "main_sequence/log_spread",
        "spread about the main sequence",
        "log",
        "SD of log (peak speed / sampled main sequence)",
        compute=_log_spread,
        source="sampling: Mack et al. 2017",
        caveat="sampling alone causes a spread of 0.2 to 0.3 at 25 frames per second",
    ),
    _measure(
        "saccades/duration",
        "mean saccade duration",
        "s",
        "mean of offset - onset",
        compute=ratio("saccade.duration_s", "saccade.timed_saccades"),
        count_key="saccade.timed_saccades",
        min_count=100,
        rate_dependent=True,
        source="Collewijn, Erkelens & Steinman 1988",
        caveat="only at 60 frames per second or more: below, a frame is as long as a saccade; increases with smoothing",
    ),
    _interval(
        "saccades/interval_cv",
        "variation of saccade intervals",
        "CV",
        "SD / mean of the time between onsets",
        compute=variation("saccade.interval"),
        source=LEE,
        caveat="short clips truncate long intervals",
    ),
    _interval(
        "saccades/interval_distance",
        "saccade intervals, Wasserstein",
        "SD of truth",
        "area between the distribution functions of the time between onsets / SD of the reference's",
        compare=lambda totals, other: INTERVAL_S.distance(totals["saccade.interval"], other["saccade.interval"]),
        direction="lower",
        source="Kantorovich 1942",
        caveat="truncation of intervals depends on the length of the clips",
    ),
    _interval(
        "fixations/duration_median",
        "median fixation duration",
        "s",
        "median time from the end of a saccade to the onset of the next",
        compute=lambda totals: INTERVAL_S.quantile(totals["saccade.fixation"], 0.5),
        source="Salvucci & Goldberg 2000",
        caveat="small saccades that the detector misses merge fixations",
    ),
)


# Statistics of the reference ranges, from arrays pooled over clips (pooled.py).
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


def extract_pool(behaviour: Behaviour) -> PooledArrays:
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
    from scipy.optimize import least_squares

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
    from scipy.optimize import least_squares

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
