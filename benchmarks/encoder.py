"""Speed, scaling and memory of the default speech encoder.

The packaged recording is repeated to 10 s, 1 min and 10 min, and each length is encoded in a separate process. Prints
CPU seconds per 10 s of sound (one thread), their growth, and peak memory beyond the sound and the features.

Run     python -m benchmarks.encoder     (make bench)
Reads   conf/ (embed=default)
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from dataclasses import dataclass

import numpy as np

from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import read_speech
from talkingeyes.core.settings import validate_section
from talkingeyes.orchestration.run import run_command

DURATIONS_S = (10, 60, 600)
FPS = 25.0


@dataclass(frozen=True)
class Cost:
    """CPU seconds and peak memory of one process that encoded one sound."""

    cpu_s: float
    peak_mib: float


def default_settings() -> EmbedSettings:
    """The section `embed` of conf/."""
    from talkingeyes.orchestration.config import compose

    return validate_section("embed", EmbedSettings, compose()["embed"])


def measure(settings: EmbedSettings, seconds: int) -> Cost:
    """Encode `seconds` of speech after a warm-up."""
    encoder = make_encoder(settings)
    speech = read_speech(package_file(EXAMPLE_SPEECH))
    sound = np.tile(speech, seconds * 16_000 // len(speech) + 1)[: seconds * 16_000]
    encoder(sound[:160_000], FPS)
    start = time.process_time()
    features = encoder(sound, FPS)
    cpu_s = time.process_time() - start
    own_mib = (sound.nbytes + features.nbytes) / 2**20
    return Cost(cpu_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - own_mib)


def main() -> None:
    """Measure each length in a separate process, so that memory peaks do not mix."""
    spawn = multiprocessing.get_context("spawn")
    with spawn.Pool(1) as pool:  # in a process of its own, because a process inherits the peak of its parent
        settings = pool.apply(default_settings)
    print("sound (s)   CPU s per 10 s   x real time   peak MiB beyond sound and features")
    measured = {}
    for seconds in DURATIONS_S:
        with spawn.Pool(1) as pool:
            measured[seconds] = pool.apply(measure, (settings, seconds))
        cpu_s = measured[seconds].cpu_s
        peak_mib = measured[seconds].peak_mib
        print(f"{seconds:9d}   {cpu_s / seconds * 10:14.3f}   {seconds / cpu_s:11.0f}   {peak_mib:10.0f}")
    first, minute, long = (measured[seconds] for seconds in DURATIONS_S)
    print(f"time of 10 min over 60 times that of 10 s: {long.cpu_s / (60 * first.cpu_s):.2f}")
    print(f"peak memory of 10 min over that of 1 min: {long.peak_mib / minute.peak_mib:.2f}")


if __name__ == "__main__":
    run_command(main)
