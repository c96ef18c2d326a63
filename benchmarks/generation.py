"""Speed, scaling and memory of motion generation with the default model.

The packaged recording is repeated to 10 s, 1 min, 10 min and an hour and embedded first, which is not counted. Each
length is generated in a separate process: first gaze and head alone, then a complete animation with blinks, events and,
if there is a face model, the face. Ten samples at once are compared with one, alternating in one process. Decoders that
compute their prefix again for every frame: benchmarks/peers.py.

Run     python -m benchmarks.generation [data/train/MODEL]     (make bench, after make repro)
Reads   data/train/talkingeyes_events, or the given model
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np

from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import read_speech
from talkingeyes.orchestration.run import run_command

if TYPE_CHECKING:
    from talkingeyes.animation.animator import Animator

P = ParamSpec("P")
Result = TypeVar("Result")

MODEL = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("data", "train", "talkingeyes_events")
DURATIONS_S = (10, 60, 600, 3600)
REPEATS = 25  # of the shortest length, with different seeds: the median, because single runs vary
TURNS = 101


@dataclass(frozen=True)
class Cost:
    """CPU seconds of gaze and head, of a complete animation, and its peak memory beyond the inputs and outputs."""

    cpu_s: float
    whole_cpu_s: float
    peak_mib: float


def measure(embedding: np.ndarray, samples: int) -> Cost:
    """Animate embedded speech after a warm-up."""
    from talkingeyes.animation.animator import Animator

    animator = Animator.load(MODEL)
    animator.generate_from_embedding(embedding[:250], samples, seed=0, fps=animator.fps)
    repeats = REPEATS if len(embedding) <= DURATIONS_S[0] * animator.fps else 1
    drawn_s = [_drawn_s(animator, embedding, first, samples) for first in range(repeats)]
    start = time.process_time()
    made = animator.generate_from_embedding(embedding, samples, seed=0, fps=animator.fps)
    whole_cpu_s = time.process_time() - start
    arrays = [
        getattr(one.motion, name).nbytes for one in made for name in ("head", "gaze", "lid", "jaw", "translation")
    ]
    own_mib = (embedding.nbytes + sum(arrays)) / 2**20
    return Cost(
        float(np.median(drawn_s)), whole_cpu_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - own_mib
    )


def relative_cost(embedding: np.ndarray, samples: int) -> float:
    """Median CPU seconds of several samples over those of one, alternating, because shared machines vary in speed."""
    from talkingeyes.animation.animator import Animator

    animator = Animator.load(MODEL)
    drawn_s = np.array(
        [[_drawn_s(animator, embedding, first, count) for count in (1, samples)] for first in range(TURNS)]
    )
    one, several = np.median(drawn_s[1:], axis=0)  # the first is a warm-up
    return float(several / one)


def _drawn_s(animator: Animator, embedding: np.ndarray, first: int, samples: int) -> float:
    """CPU seconds of gaze and head, for seeds from `first` on."""
    start = time.process_time()
    animator.generator.generate(embedding, list(range(first, first + samples)), animator.fps)
    return time.process_time() - start


def embed(seconds: int) -> np.ndarray:
    """Speech features of the packaged recording, repeated, from the model's encoder."""
    from talkingeyes.animation.animator import Animator

    animator = Animator.load(MODEL)
    speech = read_speech(package_file(EXAMPLE_SPEECH))
    sound = np.tile(speech, seconds * 16_000 // len(speech) + 1)[: seconds * 16_000]
    return animator.encoder(sound, animator.fps)


def main() -> None:
    """Run each measurement in a separate process, so that memory peaks do not mix."""
    spawn = multiprocessing.get_context("spawn")

    def apart(function: Callable[P, Result], *arguments: P.args, **named: P.kwargs) -> Result:
        with spawn.Pool(1) as pool:
            return pool.apply(function, arguments, named)

    embeddings = {seconds: apart(embed, seconds) for seconds in DURATIONS_S}
    print("speech (s)   samples   gaze and head, CPU s   per 10 s   whole, CPU s   peak MiB beyond inputs and outputs")
    one = {}
    for seconds, samples in [*((length, 1) for length in DURATIONS_S), (10, 10)]:
        measured = apart(measure, embeddings[seconds], samples)
        print(
            f"{seconds:10d}   {samples:7d}   {measured.cpu_s:20.3f}   {measured.cpu_s / seconds * 10:8.3f}"
            f"   {measured.whole_cpu_s:12.2f}   {measured.peak_mib:10.0f}"
        )
        if samples == 1:
            one[seconds] = measured
    print(f"ten samples over one, alternating: {apart(relative_cost, embeddings[10], 10):.2f}")
    first, minute, hour = one[10], one[60], one[3600]
    print(f"time of an hour over 360 times that of 10 s: {hour.cpu_s / (360 * first.cpu_s):.2f}")
    print(f"peak memory of an hour over that of 1 min: {hour.peak_mib / minute.peak_mib:.2f}")


if __name__ == "__main__":
    run_command(main)
