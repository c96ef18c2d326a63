"""Speed and memory of head motion by PoseGAN: ten minutes and an hour, window by window.

Run: python -m benchmarks.posegan [FOLDER of a trained model]        default: an untrained network of the same size
Prints CPU seconds of ten minutes (target: under 2) and the peak memory (anonymous pages: the speech is memory-mapped)
of ten minutes and of an hour, which should be equal, because only one window is held at a time.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from talkingeyes.models.speech_to_pose import SpeechToPose
from talkingeyes.orchestration.config import compose
from talkingeyes.training.checkpoint import load
from talkingeyes.training.motion_generators import pose_network
from talkingeyes.training.pose_task import PoseTaskSettings

CHANNELS = 291  # of the default encoder
FPS = 30


def network() -> SpeechToPose:
    """The given model, or an untrained one."""
    if len(sys.argv) > 1:
        return pose_network(load(Path(sys.argv[1])))
    settings = PoseTaskSettings.model_validate(compose(("+model@model.posegan=posegan",))["model"]["posegan"])
    return SpeechToPose(settings, [str(index) for index in range(CHANNELS)], list("abcde")).eval()


@dataclass(frozen=True)
class Cost:
    """CPU seconds, and the peak of the memory after each window."""

    cpu_s: float
    peak_mib: float


def generated(model: SpeechToPose, speech: np.ndarray) -> Cost:
    """Generate and drop all windows."""
    start, peak_mib = time.process_time(), 0.0
    for _ in model.stream(speech, [0], model.style_of(model.speakers[0])):
        peak_mib = max(peak_mib, own_mib())
    return Cost(time.process_time() - start, peak_mib)


def own_mib() -> float:
    """Anonymous memory of this process."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines["RssAnon"].split()[0]) / 1024


def main() -> None:
    """Measure ten minutes, then an hour, from a memory-mapped file."""
    model = network()
    channels = len(model.speech.mean)
    with tempfile.TemporaryDirectory() as folder:
        for minutes in (1, 10, 60):
            path = Path(folder, f"{minutes}.npy")
            speech = np.lib.format.open_memmap(path, "w+", np.float32, (minutes * 60 * FPS, channels))
            for first in range(0, len(speech), 60 * FPS):
                speech[first : first + 60 * FPS] = np.random.default_rng(first).standard_normal((60 * FPS, channels))
            speech.flush()
            del speech
            cost = generated(model, np.load(path, mmap_mode="r"))
            print(f"{minutes:3d} min: {cost.cpu_s:6.2f} CPU s, peak {cost.peak_mib:6.1f} MiB")


if __name__ == "__main__":
    main()
