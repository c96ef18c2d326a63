"""Peak memory of `animate` for an hour of speech, after each step, in one process.

The packaged recording is repeated to an hour and written to a file; it is read, embedded, animated and saved, as
`talkingeyes animate --no-previews` does. Peaks include everything: Python, torch, the model, inputs and outputs.

Run     python -m benchmarks.long_speech [MODEL FOLDER [FRAMES PER SECOND]]     (make bench, after make repro, 4 min)
Reads   data/train/talkingeyes_events, or the given folder
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import soundfile

from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.orchestration.run import run_command

MODEL = Path("data", "train", "talkingeyes_events")
SECONDS = 3600


def write_hour(path: Path) -> None:
    """Write the repeated recording block by block."""
    speech = read_speech(package_file(EXAMPLE_SPEECH))
    with soundfile.SoundFile(path, "w", SAMPLE_RATE, 1, "PCM_16") as file:
        left = SECONDS * SAMPLE_RATE
        while left:
            part = speech[:left]
            file.write(part)
            left -= len(part)


def report(step: str) -> None:
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{step:10s} {peak_mib:8.0f} MiB   {time.process_time():7.1f} CPU s", flush=True)


def main() -> None:
    """Run the steps in one process."""
    from talkingeyes.animation.animator import Animator

    model = Path(sys.argv[1]) if len(sys.argv) > 1 else MODEL
    with tempfile.TemporaryDirectory() as folder:
        write_hour(Path(folder, "hour.flac"))
        report("written")
        animator = Animator.load(model)
        fps = float(sys.argv[2]) if len(sys.argv) > 2 else animator.fps
        report("loaded")
        sound = read_speech(Path(folder, "hour.flac"))
        report("read")
        embedding = animator.encoder(sound, animator.fps)
        report("embedded")
        (one,) = animator.generate_from_embedding(embedding, 1, 0, fps)
        report("animated")
        one.save(Path(folder, "hour.npz"))
        report("saved")
        written = (
            sum(path.stat().st_size for path in Path(folder).glob("hour.*")) - Path(folder, "hour.flac").stat().st_size
        )
        arrays = sum(
            getattr(one.motion, name).nbytes for name in ("head", "gaze", "lid", "jaw", "translation", "expression")
        )
    print(
        f"sizes: sound {sound.nbytes / 2**20:.0f} MiB, embedding {embedding.nbytes / 2**20:.0f} MiB,"
        f" motion {arrays / 2**20:.0f} MiB in memory and {written / 2**20:.0f} MiB in files"
    )


if __name__ == "__main__":
    run_command(main)
