"""Speed of synthetic data generation, in CPU time of one core: speech, motion, observations, and writing.

Run     python -m benchmarks.synthesize [SOUNDS]     (make bench; with 0, only the sizes)
Reads   conf/ (synthesize=default, paper, personal)

Cost by corpus size: a few sounds of every source, with one take and with several, are generated and extrapolated.
"""

from __future__ import annotations

import math
import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipelines.synthesize import SoundJob, sound_jobs, synthesize_sound, synthesize_speech, synthesize_takes
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.observations import identity_weights, make_camera, observe
from talkingeyes.synthesis.plan import SynthesizeSettings
from talkingeyes.synthesis.take import sample_take

# Corpora to estimate, as overrides of conf/.
SIZES = (
    ("synthesize.clips=300", "synthesize.speakers=20"),
    ("synthesize.clips=1500", "synthesize.speakers=100"),
    ("synthesize.clips=6000", "synthesize.speakers=400"),
    ("synthesize=paper",),
    ("synthesize=personal",),
)
TRIED = 24


def main() -> None:
    """Print both tables."""
    settings = SynthesizeSettings.model_validate(compose()["synthesize"])
    wanted = sound_jobs(settings)
    measure(settings, wanted[0], defaultdict(float))  # the head and the libraries are loaded once per process
    count = int(sys.argv[1]) if sys.argv[1:] else 30
    if count:
        steps(settings, wanted[:count])
    print(f"\n{'corpus':<45}{'sounds':>8}{'clips':>8}{'CPU, s':>8}{'times real time':>18}{'MiB':>6}")
    for overrides in SIZES:
        size(overrides)


def steps(settings: SynthesizeSettings, wanted: Sequence[SoundJob]) -> None:
    """Print the cost of each step of a sound."""
    spent_s: defaultdict[str, float] = defaultdict(float)
    seconds = sum(measure(settings, job, spent_s) for job in wanted)
    print(f"{len(wanted)} sounds, {seconds:.0f} s of speech; CPU time")
    print(f"{'step':<34}{'ms a sound':>12}{'times real time':>18}")
    for step, spent in spent_s.items():
        print(f"{step:<34}{1000 * spent / len(wanted):>12.1f}{seconds / spent:>18.0f}")


def size(overrides: Sequence[str]) -> None:
    """Print the cost of a whole corpus, estimated from a few of its sounds of each kind."""
    settings = SynthesizeSettings.model_validate(compose(overrides)["synthesize"])
    start = time.process_time()
    kinds = defaultdict(list)
    for job in sound_jobs(settings):
        kinds[job.sound.source, job.takes].append(job)
    cpu_s, motion_s, clips = time.process_time() - start, 0.0, 0
    for (source, takes), members in kinds.items():
        longest_s = settings.sources[source].longest_s
        tried = members[:: math.ceil(len(members) * takes * longest_s / (TRIED * 10.0))]
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            made = [clip for job in tried for clip in synthesize_sound(Path(folder), settings, job)]
            cpu_s += (time.process_time() - start) * len(members) / len(tried)
        motion_s += sum(clip.seconds for clip in made) * len(members) / len(tried)
        clips += len(members) * takes
    sounds = sum(map(len, kinds.values()))
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{' '.join(overrides):<45}{sounds:>8}{clips:>8}{cpu_s:>8.0f}{motion_s / cpu_s:>18.0f}{most:>6.0f}")


def measure(settings: SynthesizeSettings, job: SoundJob, spent_s: defaultdict[str, float]) -> float:
    """Add the time of each step for one sound to `spent_s`; return the duration of the sound."""
    start = 0.0

    def lap(step: str) -> None:
        nonlocal start
        spent_s[step] += time.process_time() - start
        start = time.process_time()

    with tempfile.TemporaryDirectory() as folder:
        sound = job.sound
        speaker = plan.speaker_of(settings, sound)
        start = time.process_time()
        spoken = synthesize_speech(Path(folder), settings, job)
        lap("synthesize and write speech")
        synthesize_takes(Path(folder), settings, replace(job, takes=1), spoken)
        lap("sample, observe and write one take")
    motion_random = plan.seeded_generator(settings.seed, "motion", sound.index)
    start = time.process_time()
    take = sample_take(spoken.annotation, speaker.style, spoken.seconds, motion_random, settings.blink_profile)
    lap("  sample a take")
    motion = take.motion(settings.fps, len(spoken.sound) * 25 // SAMPLE_RATE)
    lap("  render at 25 fps")
    rng = plan.seeded_generator(settings.seed, "noise", sound.index)
    identity = identity_weights(speaker.identity, settings.camera)
    observe(motion, make_camera(settings.camera, rng), settings.noise, rng, identity)
    lap("  observe")
    take.motion(500.0, round(500 * spoken.seconds))
    lap("(render at 500 fps)")
    return spoken.seconds


if __name__ == "__main__":
    run_command(main)
