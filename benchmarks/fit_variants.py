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
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import gaze_in_space, gaze_to_angles
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.detectors import scoring
from talkingeyes.evaluation.detectors.saccades import Saccades, detect_saccades
from talkingeyes.fitting.accuracy import ErrorSums, FitReference
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.fitting.comparison import blink_frames
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


@dataclass(frozen=True)
class Case:
    """Ground truth of a clip."""

    clip: Clip
    motion: Motion
    blinking: np.ndarray
    saccades: Saccades


def main() -> None:
    """Print the table."""
    root = Path((sys.argv[1:2] or ["data/synthesize"])[0])
    if not sys.argv[1:] and not root.exists():  # make bench
        print("fit_variants: no corpus in data/synthesize (make repro), nothing to measure")
        return
    split, count = (sys.argv[2:3] or ["val"])[0], int((sys.argv[3:4] or ["4"])[0])
    corpus = Corpus(root)
    clips = corpus.select(split, take=0)[:count]
    if not corpus.has_truth or not clips:
        raise InputError(f"fit_variants: {root} should have truth and clips of {split}, got {len(clips)} clips")
    cases = [case_of(corpus, clip) for clip in clips]
    print(f"{len(cases)} clips of {split}; frames without blinks")
    print(f"{'':<20}{'error px':>9}{'ratio':>7}{'degrees':>9}{'peaks':>7}{'seq., spread':>13}{'found':>8}{'true':>7}")
    print(line("truth", corpus, cases, [case.motion for case in cases]))
    for name, overrides in VARIANTS.items():
        settings = FitSettings.model_validate(compose(list(overrides))["fit"])
        fits = [fit_clip(corpus.observation(case.clip), settings).motion for case in cases]
        print(line(name, corpus, cases, fits), flush=True)


def case_of(corpus: Corpus, clip: Clip) -> Case:
    """Ground truth of a clip, with the saccades detectable at its frame rate."""
    motion, events = corpus.truth(clip), corpus.truth_events(clip)
    blinking = blink_frames(events, len(motion), motion.fps)
    return Case(clip, motion, blinking, saccades_of(motion, blinking))


def saccades_of(motion: Motion, blinking: np.ndarray) -> Saccades:
    """Saccades of the mean direction of both eyes in space, outside blinks."""
    return detect_saccades(gaze_in_space(motion.head, motion.gaze).mean(axis=1), motion.fps, ~blinking)


def line(name: str, corpus: Corpus, cases: Sequence[Case], motions: Sequence[Motion]) -> str:
    """A row, pooled over clips."""
    total, truth, matched = ErrorSums(), ErrorSums(), scoring.DetectionCounts()
    degrees, peaks = [], []
    for case, motion in zip(cases, motions, strict=True):
        seen = corpus.observation(case.clip)
        reference = FitReference(seen.pupils, seen.camera, ~case.blinking, case.motion, case.motion)
        total, truth = total + reference.error_sums(motion), truth + reference.error_sums(case.motion)
        apart = gaze_to_angles(motion.gaze) - gaze_to_angles(case.motion.gaze)
        degrees.append(np.degrees(np.linalg.norm(apart, axis=-1))[~case.blinking].ravel())
        found = saccades_of(motion, case.blinking)
        large, known = (each.amplitude_deg >= AMPLITUDE_DEG for each in (found, case.saccades))
        matched += scoring.count_matches(found.onset_s[large], case.saccades.onset_s[known], TOLERANCE_S)
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
