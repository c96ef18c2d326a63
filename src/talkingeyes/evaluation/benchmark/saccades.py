"""Metrics of saccades of gaze in space (rate, amplitude, direction, main sequence, duration) and of fixations.

Peak speeds are compared with the main sequence as sampled at the frame rate of the motion: at 25 frames per second a
saccade of five degrees shows less than half its true peak speed (Mack et al. 2017), so the truth would not follow the
continuous main sequence. Sources: Bahill, Clark & Stark 1975; Lee, Badler & Badler 2002; Salvucci & Goldberg 2000.
Directions: sector 0 is the subject's left, 2 up, 4 right, 6 down.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.benchmark.behaviour import Behaviour
from talkingeyes.evaluation.benchmark.metric import Bins, Extractor, Metric, Sums, Totals, ratio, safe_divide
from talkingeyes.evaluation.detectors.saccades import MIN_DURATION_FPS
from talkingeyes.physiology import saccades as main_sequence_model

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
    duration = main_sequence_model.duration_s(amplitude)
    frames = int(np.ceil(float(duration.max()) * fps)) + 2
    times_s = (
        np.arange(frames)[None, None] - 1 + (np.arange(SAMPLING_PHASES)[None, :, None] + 0.5) / SAMPLING_PHASES
    ) / fps
    phase, skewness = np.broadcast_arrays(times_s / duration, main_sequence_model.skew(amplitude))
    done = main_sequence_model.completed_fraction(phase, skewness)
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


def _interval_variation(totals: Totals) -> Float[ndarray, " D"]:
    mean = safe_divide(totals["saccade.interval_s"], totals["saccade.intervals"])
    square = safe_divide(totals["saccade.interval_s2"], totals["saccade.intervals"])
    return safe_divide(np.sqrt(np.maximum(square - mean**2, 0)), mean)


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
        compute=_interval_variation,
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
