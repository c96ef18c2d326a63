"""Stage `synthesize`: a synthetic corpus of spoken text with true motion and what a camera sees of it.

Reads nothing (text, voices and motion are the project's own) Writes data/synthesize/: clips.parquet, speech/,
annotations/, observations/, truth/ (docs/conventions.md) Run python -m pipelines.synthesize

Splits are known before any sound is made: 15 % of the speakers are unseen, the rest 8:1:1 by sentence. Some sounds of
test and unseen have several takes: one sound, motion drawn again, for the one-to-many tests.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from talkingeyes.corpus.index import SPLITS, Clip
from talkingeyes.corpus.splits import split_sounds
from talkingeyes.corpus.store import Corpus
from talkingeyes.errors import InputError
from talkingeyes.motion import Motion
from talkingeyes.run import Report, Workspace, each, main
from talkingeyes.world import plan
from talkingeyes.world.observations import make_camera, observe
from talkingeyes.world.plan import Sound, SynthesizeSettings
from talkingeyes.world.recording import SAMPLE_RATE, record
from talkingeyes.world.take import perform


@dataclass(frozen=True)
class Order:
    """A sound to make, in its split, with so many takes."""

    sound: Sound
    split: str
    takes: int


def run(workspace: Workspace) -> Report:
    """Plan the corpus, then make its sounds, each with all its takes."""
    settings = workspace.settings("synthesize", SynthesizeSettings)
    orders = order(settings)
    with workspace.output("synthesize") as folder:
        make = partial(make_sound, folder, settings)
        clips = [clip for made in each(make, orders, workspace.jobs, "synthesize") for clip in made]
        Corpus(folder).write_index(clips)
    return Report(metrics=_summary(clips))


def order(settings: SynthesizeSettings) -> list[Order]:
    """Sounds with their splits and takes. Raises InputError when test or unseen has too few sounds for the takes."""
    sounds = plan.sounds(settings)
    speakers = {number: plan.speaker_of(settings, number) for number in range(settings.speakers)}
    scripts = {each.id: plan.script_of(settings, each, speakers[each.speaker]) for each in sounds}
    split = split_sounds(
        {each.id: speakers[each.speaker].name for each in sounds},
        {name: script.sentences_text for name, script in scripts.items()},
        settings.seed,
    )
    several = _with_takes(split, settings)
    return [Order(each, split[each.id], settings.takes if each.id in several else 1) for each in sounds]


def _with_takes(split: Mapping[str, str], settings: SynthesizeSettings) -> set[str]:
    chosen: set[str] = set()
    for name in SPLITS:
        members = sorted(sound for sound, where in split.items() if where == name)
        if not members:
            raise InputError(
                f"synthesize.clips: no sound is left for {name}; there should be more, got {settings.clips}"
            )
        if name in ("test", "unseen"):
            random = plan.generator(settings.seed, "takes", SPLITS.index(name))
            count = min(settings.multi_take_sounds, len(members))
            chosen.update(str(sound) for sound in random.choice(members, count, replace=False))
    return chosen


def make_sound(root: Path, settings: SynthesizeSettings, order: Order) -> list[Clip]:
    """Speak one sound and perform its takes; write all of it, return its rows of the index."""
    corpus, sound = Corpus(root), order.sound
    speaker = plan.speaker_of(settings, sound.speaker)
    script = plan.script_of(settings, sound, speaker)
    random = plan.generator(settings.seed, "sound", sound.index)
    recording = record(script, speaker.voice, settings.shortest_s, settings.longest_s, random)
    corpus.write_sound(sound.id, recording.sound, recording.annotation)
    camera = make_camera(settings.camera)
    frames = int(len(recording.sound) * settings.fps) // SAMPLE_RATE
    clips = []
    for number in range(order.takes):
        random = plan.generator(settings.seed, "motion", sound.index, number)
        take = perform(recording.annotation, speaker.style, recording.seconds, random, settings.blink_profile)
        motion = take.motion(settings.fps, frames)
        seen = observe(motion, camera, settings.noise, plan.generator(settings.seed, "noise", sound.index, number))
        clip = Clip(
            id=f"{sound.id}-t{number}",
            sound=sound.id,
            take=number,
            speaker=speaker.name,
            split=order.split,
            seconds=recording.seconds,
            fps=settings.fps,
            emotion="neutral",
            intensity=0,
            language=speaker.voice.language,
            text=recording.text,
            source="talkingeyes synthesize",
            licence="CC0-1.0",
            content_hash=_content_hash(recording.sound, motion),
        )
        corpus.write_clip(clip.id, seen, motion, take.events)
        clips.append(clip)
    return clips


def _content_hash(sound: np.ndarray, motion: Motion) -> str:
    content = hashlib.blake2b(digest_size=16)
    for array in (sound, motion.head, motion.gaze, motion.lid):
        content.update(np.ascontiguousarray(array, np.float32).tobytes())
    return content.hexdigest()


def _summary(clips: list[Clip]) -> dict[str, float]:
    sounds = {clip.sound: clip.seconds for clip in clips}
    counts = {f"sounds/{name}": float(len({c.sound for c in clips if c.split == name})) for name in SPLITS}
    return {**counts, "clips": float(len(clips)), "minutes": sum(sounds.values()) / 60.0}


if __name__ == "__main__":
    main(run)
