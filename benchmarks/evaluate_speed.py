"""Speed and memory of `talkingeyes evaluate` for 10, 100, 1,000 and more clips of 10 seconds.

Run     python -m benchmarks.evaluate_speed [CLIPS ...]

The corpus contains few different motions, linked under many names. Every count runs in a separate process, with one
motion and with ten samples per sound. Speed is seconds of evaluated motion per CPU second: first without counting the
reference motion, which is evaluated too; then also without start-up and resampling; then with the reference counted.
Memory is the peak of the process.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import eye_in_head
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.physiology import saccades

SECONDS, FPS, PEOPLE = 10.0, 25.0, 20
SAMPLES = (1, 10)


def person(seed: int) -> Motion:
    """A motion with a saccade every 0.8 s and a swaying head."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(SECONDS * FPS)) / FPS
    chain, gaze = [], np.zeros(2)
    for onset in np.arange(0.5, SECONDS - 0.5, 0.8) + rng.uniform(0, 0.2):
        chain.append(saccades.sample_saccade(onset, gaze, np.radians(rng.normal(0, 6, 2)), rng))
        gaze = np.array(chain[-1].end_rad)
    space = saccades.gaze_path(chain, (0.0, 0.0), times)
    head = np.radians(4) * np.sin(times[:, None] * [1.0, 1.7, 2.3] + rng.uniform(0, 6, 3))
    return Motion.of(FPS, head, eye_in_head(head, np.repeat(space[:, None], 2, axis=1)))


def make(root: Path, count: int, samples: int) -> None:
    """Create a corpus of linked clips, and samples of each."""
    made = [root / f"{seed}.npz" for seed in range(PEOPLE)]
    for seed, path in enumerate(made):
        person(seed).save(path)
    clips = []
    for index in range(count):
        name = f"c{index:06d}"
        Annotation(speaking=(Span(1, 4), Span(5, 9))).save(make_shard_path(root / "annotations", name, ".json"))
        os.link(made[index % PEOPLE], make_shard_path(root / "truth", name, ".npz"))
        for sample in range(samples):
            other = made[(index + sample) % PEOPLE]
            os.link(other, make_shard_path(root / "motions", f"{name}-s{sample}", ".npz"))
        clips.append(Clip(name, name, 0, "a", "test", SECONDS, FPS, "", 0, "en", "", "", "CC0-1.0", ""))
    Corpus(root).write_index(clips)


def child(root: Path) -> None:
    """Evaluate the samples against the truth; print CPU seconds and megabytes."""
    from talkingeyes.workflows.evaluate import evaluate

    start = time.process_time()
    evaluate(root / "motions", root)
    print(time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    """Print a line per number of samples and clips."""
    titles = f"{'samples':>7} {'clips':>7} {'CPU s':>7} {'x real time':>12} {'without start':>14} {'all':>6}"
    print(f"{titles} {'peak MB':>8}")
    for samples in SAMPLES:
        before = None
        for count in [int(each) for each in sys.argv[1:]] or [10, 100, 1000]:
            with tempfile.TemporaryDirectory() as folder:
                make(Path(folder), count, samples)
                done = subprocess.run([sys.executable, __file__, "--child", folder], capture_output=True, check=True)
            cpu, megabytes = map(float, done.stdout.split())
            seconds = count * samples * SECONDS
            line = f"{samples:7d} {count:7d} {cpu:7.2f} {seconds / cpu:12.0f}"
            if before:
                rate = (seconds - before[0]) / max(cpu - before[1], 1e-9)
                line += f" {rate:14.0f} {rate * (samples + 1) / samples:6.0f}"
            print(f"{line:<58} {megabytes:8.0f}", flush=True)
            before = (seconds, cpu)


if __name__ == "__main__":
    child(Path(sys.argv[2])) if sys.argv[1:2] == ["--child"] else main()
