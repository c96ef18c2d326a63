"""Effect of each camera corruption on the fit: Table VIII, head and blinks, one parameter of `synthesize` at a time.

The takes are those of sketched clips (without speech synthesis). Seeds are fixed, so a row differs from the first only
by its parameter.

Run     python -m benchmarks.camera_faults [CLIPS]      (32 by default: about half a minute)
Reads   conf/ (synthesize=default, fit=default)
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from pipelines.fit import method_comparison, summarise
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.fitting.comparison import FitEvaluation, GroundTruth, evaluate_fit
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.physiology.blinks import PHYSIOLOGICAL
from talkingeyes.synthesis.detector_noise import NoiseSettings
from talkingeyes.synthesis.observations import CameraSettings, identity_weights, make_camera, observe
from talkingeyes.synthesis.sketched_clips import sketch_annotation
from talkingeyes.synthesis.speakers import sample_style
from talkingeyes.synthesis.take import Take, sample_take

SECONDS, FPS = 9.0, 25.0
CHANGES: dict[str, tuple[str, ...]] = {
    "as in default": (),
    "all heads alike": ("camera.identity_std=0",),
    "heads twice as different": ("camera.identity_std=0.3",),
    "camera 0.4 m away": ("camera.distance_min_m=0.4", "camera.distance_max_m=0.4"),
    "camera 4 m away": ("camera.distance_min_m=4", "camera.distance_max_m=4"),
    "3 occlusions a minute": ("noise.occlusion.rate_per_min=3",),
    "10 occlusions a minute": ("noise.occlusion.rate_per_min=10",),
    "2 % of frames lost": ("noise.frame_drops.dropped_fraction=0.02",),
    "10 % of frames lost": ("noise.frame_drops.dropped_fraction=0.1",),
    "whole pixels": ("noise.quantisation_px=1",),
    "half the resolution": ("noise.resolution=0.5",),
    "a quarter": ("noise.resolution=0.25",),
}


def takes(count: int) -> list[Take]:
    """Sample one take for each of `count` speakers."""
    drawn = []
    for number in range(count):
        rng = np.random.default_rng([1, number])
        drawn.append(sample_take(sketch_annotation(SECONDS, rng), sample_style(rng), SECONDS, rng, PHYSIOLOGICAL))
    return drawn


def fitted(drawn: list[Take], section: dict[str, Any], settings: FitSettings) -> list[FitEvaluation]:
    """Evaluate the fit of all takes as observed by the camera of this section."""
    camera, noise = CameraSettings(**section["camera"]), NoiseSettings(**section["noise"])
    evaluations = []
    for number, take in enumerate(drawn):
        rng = np.random.default_rng([2, number])
        shape = identity_weights(rng.standard_normal(6).tolist(), camera)
        motion = take.motion(FPS, round(SECONDS * FPS))
        seen = observe(motion, make_camera(camera, rng), noise, rng, shape)
        fit = fit_clip(seen, settings)
        if not fit.reject_reason:
            evaluations.append(evaluate_fit(seen, fit, GroundTruth(motion, take.events), settings, by_adam=False))
    return evaluations


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if sys.argv[1:] else 32
    drawn = takes(count)
    print(
        f"{count} clips of {SECONDS:.0f} s   pupil error   speed    saccade    head           blinks             fits"
    )
    print(f"{'':<28}{'px':>8}{'ratio':>11}{'peaks':>9}{'degrees':>10}{'mm':>7}{'found':>9}{'right':>8}{'kept':>9}")
    for name, changes in CHANGES.items():
        conf = compose([f"synthesize.{change}" for change in changes])
        evaluations = fitted(drawn, conf["synthesize"], FitSettings.model_validate(conf["fit"]))
        row, means = method_comparison(evaluations)["rows"][0], summarise(evaluations, count)
        print(
            f"{name:<28}{row['error_px']:8.2f}{row['velocity_ratio']:11.2f}{row['saccade_peak_ratio']:9.2f}"
            f"{means['head_error_deg']:10.2f}{means['head_error_mm']:7.1f}{means['blink_recall']:9.2f}"
            f"{means['blink_precision']:8.2f}{len(evaluations):9d}"
        )


if __name__ == "__main__":
    run_command(main)
