"""Contribution of each part of `fit`: pupils, gaze and saccades of its variants on a synthetic corpus.

Columns  error px and ratio of speeds as in Table VIII; degrees between fitted and true gaze in the head; peaks of true
         saccades relative to the truth; seq.: peak frame speed of a saccade over that of the main sequence
         (amplitude by duration, at least a frame), median and spread; found and true: recall and precision of saccades
         of at least 2 degrees, within 80 ms of a true one.
Run      python -m benchmarks.fit_variants [CORPUS [SPLIT [CLIPS]]]
Reads    a corpus with truth (data/synthesize), conf/fit
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.table8 import Case, read_cases
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_in_space, gaze_to_angles
from talkingeyes.evaluation.detectors import scoring
from talkingeyes.evaluation.detectors.saccades import Saccades, detect_saccades
from talkingeyes.fitting.accuracy import ErrorSums, FitReference
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.physiology import saccades as main_sequence_model

AMPLITUDE_DEG, TOLERANCE_S = 2.0, 0.08
VARIANTS: dict[str, tuple[str, ...]] = {
    "paper": ("fit=paper",),
    "paper (none)": ("fit=paper", "fit/smoothing=none"),
    "and gaussian": ("fit=paper", "fit/smoothing=gaussian"),
    "and quadratic": ("fit=paper", "fit/smoothing=quadratic"),
    "and steps": ("fit=paper", "fit/smoothing=steps"),
    "and saccades": ("fit=paper", "fit/smoothing=saccades"),
    "and eyes, Listing": ("fit=default", "fit.eye_calibration.vergence_sd_rad=10"),
    "default": ("fit=default",),
    "video": ("fit=video",),
}


def main() -> None:
    """Print the table."""
    cases = read_cases(sys.argv[1:])
    if not cases:
        return
    print(f"{'':<20}{'error px':>9}{'ratio':>7}{'degrees':>9}{'peaks':>7}{'seq., spread':>13}{'found':>8}{'true':>7}")
    print(line("truth", cases, [case.motion for case in cases]))
    for name, overrides in VARIANTS.items():
        settings = FitSettings.model_validate(compose(list(overrides))["fit"])
        fits = [fit_clip(case.observation, settings).motion for case in cases]
        print(line(name, cases, fits), flush=True)


def saccades_of(motion: Motion, without_blinks: np.ndarray) -> Saccades:
    """Saccades of the mean direction of both eyes in space, outside blinks, detectable at the frame rate."""
    return detect_saccades(gaze_in_space(motion.head, motion.gaze).mean(axis=1), motion.fps, without_blinks)


def line(name: str, cases: Sequence[Case], motions: Sequence[Motion]) -> str:
    """A row, pooled over clips."""
    total, truth, matched = ErrorSums(), ErrorSums(), scoring.DetectionCounts()
    degrees, peaks = [], []
    for case, motion in zip(cases, motions, strict=True):
        seen, open_eyes = case.observation, case.without_blinks
        reference = FitReference(seen.pupils, seen.camera, open_eyes, case.motion, case.motion)
        total, truth = total + reference.error_sums(motion), truth + reference.error_sums(case.motion)
        apart = gaze_to_angles(motion.gaze) - gaze_to_angles(case.motion.gaze)
        degrees.append(np.degrees(np.linalg.norm(apart, axis=-1))[open_eyes].ravel())
        found, true = saccades_of(motion, open_eyes), saccades_of(case.motion, open_eyes)
        large, known = (each.amplitude_deg >= AMPLITUDE_DEG for each in (found, true))
        matched += scoring.count_matches(found.onset_s[large], true.onset_s[known], TOLERANCE_S)
        peaks.append(peak_over_main_sequence(found, motion.fps))
    ratios = np.concatenate(peaks)
    spread = np.log(ratios).std() if len(ratios) else float("nan")
    return (
        f"{name:<20}{total.truth_distance_px / total.truth_distances:>9.3f}{total.speed_px_s / truth.speed_px_s:>7.2f}"
        f"{np.concatenate(degrees).mean():>9.2f}{total.peak_px_s / truth.peak_px_s:>7.2f}"
        f"{np.median(ratios):>7.2f}, {spread:.2f}{matched.score.recall:>8.2f}{matched.score.precision:>7.2f}"
    )


def peak_over_main_sequence(found: Saccades, fps: float) -> np.ndarray:
    """Peak frame speed of each saccade over the mean speed of the main sequence at the frame rate."""
    amplitudes = found.amplitude_deg[found.amplitude_deg >= AMPLITUDE_DEG]
    peaks = found.peak_speed_deg_s[found.amplitude_deg >= AMPLITUDE_DEG]
    durations = np.array([main_sequence_model.duration_s(float(np.radians(amplitude))) for amplitude in amplitudes])
    return np.asarray(peaks / (amplitudes / np.maximum(durations, 1 / fps)))


if __name__ == "__main__":
    run_command(main)
