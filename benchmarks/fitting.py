"""LightGazeFit by Gauss-Newton and by Adam as in the paper: frames per CPU second and objective.

Both minimise eq. 1 for the same clips from the same pupils and head poses, one clip at a time, all frames at once, on
one thread. Adam starts from zero and stops when the objective falls by less than 1e-6 relative in 50 steps.

Run     python -m benchmarks.fitting [CLIPS]     (make bench)
Reads   conf/ (fit=default); no corpus: the pupils are those of random gaze with detector noise
"""

from __future__ import annotations

import sys
import time

import numpy as np

from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.fitting.clip import FitSettings
from talkingeyes.fitting.lightgazefit import LightGazeFitSettings, PupilObservations, Solution, fit_gaze
from talkingeyes.head.camera import Camera
from talkingeyes.head.landmarks import head_to_scene, pupil_centres
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command

CAMERA = Camera(focal_px=1154 * 0.925, centre_px=(112.0, 120.0), distance_m=1.0, width=224, height=224)
FRAMES = 220
REPEATS = 20  # of the fast solver, which takes a few milliseconds


def observations(rng: np.random.Generator) -> PupilObservations:
    """A clip of random gaze: conjugate eyes with axes 9 degrees apart, 0.3 px of noise, one in twenty hidden."""
    head, translation = rng.normal(0, 0.08, (FRAMES, 3)), rng.normal(0, 0.005, (FRAMES, 3))
    angles_rad = rng.normal(0, 0.1, (FRAMES, 1, 2)) + np.array([[0.08, 0.0], [-0.08, 0.0]])
    seen = CAMERA.project(head_to_scene(pupil_centres(angles_to_gaze(angles_rad)), head, translation))
    seen += rng.normal(0, 0.3, seen.shape)
    seen[rng.random((FRAMES, 2)) < 0.05] = np.nan
    return PupilObservations(seen, head, translation, CAMERA)


def timed(clip: PupilObservations, settings: LightGazeFitSettings, repeats: int) -> tuple[Solution, float]:
    """The solution and its mean duration in seconds."""
    solution = fit_gaze(clip, settings)
    start = time.process_time()
    for _ in range(repeats):
        solution = fit_gaze(clip, settings)
    return solution, (time.process_time() - start) / repeats


def main() -> None:
    """Print the table."""
    import torch

    torch.set_num_threads(1)
    clips = [observations(np.random.default_rng(seed)) for seed in range(int(sys.argv[1]) if sys.argv[1:] else 5)]
    settings = FitSettings.model_validate(compose()["fit"]).lightgazefit
    frames = len(clips) * FRAMES
    print(f"{len(clips)} clips of {FRAMES} frames, one thread")
    print(f"{'solver':<14}{'steps':>8}{'seconds':>10}{'frames/s':>12}{'objective a frame':>20}")
    rate, objective = {}, {}
    for solver, repeats in (("newton", REPEATS), ("listing", REPEATS), ("adam", 1)):
        chosen = settings.model_copy(update={"solver": solver})
        runs = [timed(clip, chosen, repeats) for clip in clips]
        seconds = sum(seconds for _, seconds in runs)
        steps = np.mean([solution.steps for solution, _ in runs])
        rate[solver] = frames / seconds
        objective[solver] = float(np.mean([solution.objective for solution, _ in runs]))
        print(f"{solver:<14}{steps:>8.0f}{seconds:>10.3f}{rate[solver]:>12,.0f}{objective[solver]:>20.6e}")
    print(
        f"Gauss-Newton: {rate['newton'] / rate['adam']:.0f} times the frames per second of Adam (target: at least 100),"
    )
    print(f"at {objective['newton'] / objective['adam']:.4f} times its objective (target: at most 1)")


if __name__ == "__main__":
    run_command(main)
