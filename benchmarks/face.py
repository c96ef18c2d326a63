"""Speed of the face model: ten samples of ten seconds, and scaling with the duration of speech.

The packaged recording is repeated and embedded first, which is not counted. Prints CPU seconds of one process after a
warm-up; each length runs in a separate process, with its peak memory.

Run     python -m benchmarks.face [folder of a model of the face]     (after make report)
Reads   data/train/probtalk3d
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import read_speech
from talkingeyes.orchestration.run import configure_environment, run_command

MODEL = Path("data", "train", "probtalk3d")
SAMPLES_AND_SECONDS = ((1, 10), (10, 10), (1, 60), (1, 600))
MOST_CPU_S = 1.0  # target for ten samples of ten seconds


@dataclass(frozen=True)
class Cost:
    """CPU seconds, and the peak memory of the process."""

    cpu_s: float
    peak_mib: float


def embedded(folder: Path, seconds: int) -> np.ndarray:
    """Speech features of the packaged recording, repeated, from the model's encoder."""
    import json

    from talkingeyes.audio.encoder import EmbedSettings, make_encoder

    content = json.loads((folder / "embedding.json").read_text())
    encoder = make_encoder(EmbedSettings.model_validate(content["settings"]))
    once = encoder(read_speech(package_file(EXAMPLE_SPEECH)), content["fps"])
    return np.resize(once, (round(seconds * content["fps"]), once.shape[1]))


def measure(folder: Path, embedding: np.ndarray, samples: int) -> Cost:
    """Generate faces after a warm-up."""
    from talkingeyes.models.face.style import FaceStyle, StyleKey
    from talkingeyes.training.face_generators import load_face_generator

    generator, style = load_face_generator(folder), [StyleKey(0.0, FaceStyle(None, "happy", 2))]
    generator.generate(embedding[:50], style, [0], 25.0)
    start = time.process_time()
    generator.generate(embedding, style, list(range(samples)), 25.0)
    cpu_s = time.process_time() - start
    return Cost(cpu_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    """Print a table, and whether the target is reached."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else MODEL
    context = multiprocessing.get_context("spawn")
    longest = embedded(folder, max(seconds for _, seconds in SAMPLES_AND_SECONDS))
    print("| samples | seconds of speech | CPU seconds | peak MiB |")
    print("|---|---|---|---|")
    found = {}
    for samples, seconds in SAMPLES_AND_SECONDS:
        with context.Pool(1, initializer=configure_environment) as pool:
            one = pool.apply(measure, (folder, longest[: seconds * 25], samples))
        found[samples, seconds] = one.cpu_s
        print(f"| {samples} | {seconds} | {one.cpu_s:.2f} | {one.peak_mib:.0f} |", flush=True)
    reached = "reached" if found[10, 10] < MOST_CPU_S else "NOT reached"
    print(f"\nTen samples of ten seconds under {MOST_CPU_S:g} CPU second: {reached}")


if __name__ == "__main__":
    run_command(main)
