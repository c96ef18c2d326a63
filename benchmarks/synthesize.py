"""How fast the synthetic world is, in CPU time of one core: speech, motion, what the camera sees, and writing.

Run     python benchmarks/synthesize.py [SOUNDS]     (make bench)
Reads   conf/ (synthesize=default)
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from pipelines.synthesize import perform_sound, say_sound
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.config import compose
from talkingeyes.run import quiet
from talkingeyes.world import plan
from talkingeyes.world.observations import head_shape, make_camera, observe
from talkingeyes.world.plan import SynthesizeSettings
from talkingeyes.world.take import perform


def main() -> None:
    """Print the table."""
    settings = SynthesizeSettings.model_validate(compose()["synthesize"])
    sounds = plan.sounds(settings)[: int(sys.argv[1]) if sys.argv[1:] else 30]
    spent_s: defaultdict[str, float] = defaultdict(float)
    measure(settings, sounds[0], defaultdict(float))  # the head and the libraries are read once a process
    seconds = sum(measure(settings, sound, spent_s) for sound in sounds)
    print(f"{len(sounds)} sounds, {seconds:.0f} s of speech; CPU time")
    print(f"{'step':<34}{'ms a sound':>12}{'times real time':>18}")
    for step, spent in spent_s.items():
        print(f"{step:<34}{1000 * spent / len(sounds):>12.1f}{seconds / spent:>18.0f}")
    takes = sum(sound.takes for sound in plan.sounds(settings)) / settings.clips
    speak, move = list(spent_s.values())[:2]
    print(f"a sound with its {takes:.2f} takes: {seconds * takes / (speak + takes * move):.0f} times real time")


def measure(settings: SynthesizeSettings, sound: plan.Sound, spent_s: defaultdict[str, float]) -> float:
    """Add up the time of each step for one sound; how long the sound is."""
    start = 0.0

    def lap(step: str) -> None:
        nonlocal start
        spent_s[step] += time.process_time() - start
        start = time.process_time()

    with tempfile.TemporaryDirectory() as folder:
        speaker = plan.speaker_of(settings, sound)
        start = time.process_time()
        spoken = say_sound(Path(folder), settings, sound)
        lap("speak, and write it")
        perform_sound(Path(folder), settings, replace(sound, takes=1), spoken)
        lap("move, observe and write one take")
    motion_random = plan.generator(settings.seed, "motion", sound.index)
    start = time.process_time()
    take = perform(spoken.annotation, speaker.style, spoken.seconds, motion_random, settings.blink_profile)
    lap("  draw a take")
    motion = take.motion(settings.fps, len(spoken.sound) * 25 // SAMPLE_RATE)
    lap("  render at 25 frames a second")
    random = plan.generator(settings.seed, "noise", sound.index)
    identity = head_shape(speaker.identity, settings.camera)
    observe(motion, make_camera(settings.camera, random), settings.noise, random, identity)
    lap("  observe")
    take.motion(500.0, round(500 * spoken.seconds))
    lap("(render at 500 frames a second)")
    return spoken.seconds


if __name__ == "__main__":
    quiet()
    main()
