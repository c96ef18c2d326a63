"""Cost of a live stream: CPU seconds per second of sound on one core, by chunk size.

Run: python -m benchmarks.streaming [MODEL] Prints, for a real recording, CPU seconds per second of sound for the stream
and for the whole speech at once, the stated latency, and the largest difference between the two in radians.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import torch

from talkingeyes.animation.streaming import LiveModel
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech

SECONDS, CHUNKS_S = 15, (0.01, 0.04, 0.16, 1.0)


def main(model: Path) -> None:
    """Measure and print."""
    torch.set_num_threads(1)
    live, sound = LiveModel.load(model), read_speech(package_file(EXAMPLE_SPEECH))[: SECONDS * SAMPLE_RATE]
    begun = time.process_time()
    whole = live.generate_offline(sound, seed=1)
    print(f"stated latency {live.latency_s:.3f} s; whole: {(time.process_time() - begun) / SECONDS:.3f} CPU s per s")
    for chunk_s in CHUNKS_S:
        size, stream = round(chunk_s * SAMPLE_RATE), live.stream(seed=1)
        begun = time.process_time()
        parts = [stream.push(sound[start : start + size]) for start in range(0, len(sound), size)]
        parts.append(stream.finish())
        cost = (time.process_time() - begun) / SECONDS
        apart = max(
            np.abs(np.concatenate([getattr(p, n) for p in parts]) - getattr(whole, n)).max() for n in ("head", "gaze")
        )
        print(f"chunks of {chunk_s * 1000:4.0f} ms: {cost:.3f} CPU s per s; differs from the whole by {apart:.1e} rad")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data/train/talkingeyes_live"))
