"""How fast the default model makes motion, how that grows with the speech, and what memory it takes.

The packaged recording is repeated to 10 s, 1 min and 10 min and embedded first, which is not counted; each length is
generated in a process of its own, blinks and events included. Ten samples at once are set against one, and the cached
decoder against one of the same size that computes the prefix again for every code, as eq. 10 of the paper reads.

Run     python benchmarks/generation.py [data/train/MODEL]     (make bench, after make repro)
Reads   data/train/talkingeyes, or the model that is named; without codes of gaze there is nothing to compute again
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.audio.encoder_moonshine import SPEECH, packaged
from talkingeyes.audio.waveform import read_speech
from talkingeyes.run import quiet, shell

MODEL = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("data", "train", "talkingeyes")
LENGTHS_S = (10, 60, 600)


@dataclass(frozen=True)
class Measured:
    """CPU seconds and peak memory beyond the inputs and outputs of one process."""

    cpu_s: float
    peak_mib: float


def measure(embedding: np.ndarray, samples: int) -> Measured:
    """Perform an embedded speech, after a warm-up."""
    from talkingeyes.performance.perform import Performer

    performer = Performer.load(MODEL)
    performer.perform_embedded(embedding[:250], samples, seed=0, fps=performer.fps)
    start = time.process_time()
    made = performer.perform_embedded(embedding, samples, seed=0, fps=performer.fps)
    cpu_s = time.process_time() - start
    arrays = [
        getattr(one.motion, name).nbytes for one in made for name in ("head", "gaze", "lid", "jaw", "translation")
    ]
    own_mib = (embedding.nbytes + sum(arrays)) / 2**20
    return Measured(cpu_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - own_mib)


def recomputed(embedding: np.ndarray) -> float | None:
    """CPU seconds of the gaze codes alone when every step computes the whole prefix again, without caches."""
    import torch

    from talkingeyes.learning.trained import NetworkGenerator, load_generator
    from talkingeyes.models.gaze.categorical import CategoricalGaze
    from talkingeyes.models.gaze.generator import Condition

    generator = load_generator(MODEL)
    assert isinstance(generator, NetworkGenerator)
    network = generator.network
    if not isinstance(network.gaze, CategoricalGaze):
        return None
    start = time.process_time()
    with torch.no_grad():
        speech = network.speech(torch.from_numpy(embedding)[None])
        still = torch.zeros(1, len(embedding), 3)
        memory = network.gaze.memory(Condition(speech, still, still))
        for step in range(memory.shape[1]):
            features = network.gaze.transformer(memory[:, : step + 1], memory)
            network.gaze.out(features)
            network.gaze.codebook.decode(
                torch.zeros(1, step + 1, network.gaze.codebook.settings.quantiser.width),
                torch.zeros(1, step + 1, dtype=torch.bool),
            )
    return time.process_time() - start


def embed(seconds: int) -> np.ndarray:
    """The packaged recording, repeated, as the model hears it."""
    from talkingeyes.performance.perform import Performer

    performer = Performer.load(MODEL)
    speech = read_speech(packaged(SPEECH))
    sound = np.tile(speech, seconds * 16_000 // len(speech) + 1)[: seconds * 16_000]
    return performer.encoder(sound, performer.fps)


def main() -> None:
    """Each measurement in a process of its own, so that peaks do not mix."""
    spawn = multiprocessing.get_context("spawn")

    def apart(function, *arguments):
        with spawn.Pool(1) as pool:
            return pool.apply(function, arguments)

    embeddings = {seconds: apart(embed, seconds) for seconds in LENGTHS_S}
    print("speech (s)   samples   CPU s   CPU s per 10 s   peak MiB beyond inputs and outputs")
    one = {}
    for seconds, samples in [*((length, 1) for length in LENGTHS_S), (10, 10)]:
        measured = apart(measure, embeddings[seconds], samples)
        print(
            f"{seconds:10d}   {samples:7d}   {measured.cpu_s:5.2f}   {measured.cpu_s / seconds * 10:14.3f}"
            f"   {measured.peak_mib:10.0f}"
        )
        if samples == 1:
            one[seconds] = measured
        else:
            print(f"ten samples over one: {measured.cpu_s / one[seconds].cpu_s:.2f}")
    first, minute, long = (one[seconds] for seconds in LENGTHS_S)
    print(f"time of 10 min over 60 times that of 10 s: {long.cpu_s / (60 * first.cpu_s):.2f}")
    print(f"peak memory of 10 min over that of 1 min: {long.peak_mib / minute.peak_mib:.2f}")
    again = {seconds: apart(recomputed, embeddings[seconds]) for seconds in LENGTHS_S[:2]}
    for seconds, cpu_s in again.items():
        if cpu_s is not None:
            print(f"without caches, {seconds} s: {cpu_s:.2f} s, {cpu_s / one[seconds].cpu_s:.1f} times")


if __name__ == "__main__":
    quiet()
    shell(main)
