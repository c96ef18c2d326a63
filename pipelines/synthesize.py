"""Stage `synthesize`: a synthetic corpus of spoken text with true motion and what a camera sees of it.

Reads nothing (text, voices and motion are the project's own) Writes data/synthesize/: clips.parquet, speech/,
annotations/, observations/, truth/ (docs/conventions.md) Run python -m pipelines.synthesize

Splits are known before any motion is drawn: 15 % of the speakers are unseen, the rest 8:1:1 by sentence. Some sounds of
test and unseen have several takes: one sound, motion drawn again, for the one-to-many tests.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.corpus.index import SPLITS, Clip
from talkingeyes.corpus.splits import split_sounds
from talkingeyes.corpus.store import Corpus
from talkingeyes.errors import InputError
from talkingeyes.motion import Motion
from talkingeyes.run import Report, Workspace, each, main
from talkingeyes.world import plan
from talkingeyes.world.observations import head_shape, make_camera, observe
from talkingeyes.world.plan import Sound, SynthesizeSettings
from talkingeyes.world.take import perform
from talkingeyes.world.voices import speak_about


@dataclass(frozen=True)
class Said:
    """What came of speaking a sound: what the splits and the index need."""

    sound: Sound
    sentences: tuple[str, ...]
    text: str
    seconds: float
    language: str


@dataclass(frozen=True)
class Order:
    """A spoken sound to perform, in its split, so many times."""

    said: Said
    split: str
    takes: int


def run(workspace: Workspace) -> Report:
    """Speak all sounds, split them, then perform them, each with all its takes."""
    settings = workspace.settings("synthesize", SynthesizeSettings)
    with workspace.output("synthesize") as folder:
        say = partial(say_sound, folder, settings)
        said = list(each(say, plan.sounds(settings), workspace.jobs, "synthesize: speak"))
        move = partial(perform_sound, folder, settings)
        made = each(move, orders(said, settings), workspace.jobs, "synthesize: move")
        clips = [clip for takes in made for clip in takes]
        Corpus(folder).write_index(clips)
    return Report(metrics=_summary(clips))


def say_sound(root: Path, settings: SynthesizeSettings, sound: Sound) -> Said:
    """Speak one sound and write it with its annotation."""
    voice = plan.speaker_of(settings, sound).voice
    random = plan.generator(settings.seed, "sound", sound.index)
    script, spoken = speak_about(voice, settings.shortest_s, settings.longest_s, random)
    Corpus(root).write_sound(sound.id, spoken.sound, spoken.annotation)
    return Said(sound, script.sentences_text, spoken.text, spoken.seconds, voice.language)


def orders(said: Sequence[Said], settings: SynthesizeSettings) -> list[Order]:
    """Sounds with their splits and takes. Raises InputError when a split stays empty."""
    split = split_sounds(
        {each.sound.id: plan.speaker_name(each.sound.speaker) for each in said},
        {each.sound.id: each.sentences for each in said},
        settings.seed,
    )
    several = _with_takes(split, settings)
    return [Order(x, split[x.sound.id], settings.takes if x.sound.id in several else 1) for x in said]


def _with_takes(split: Mapping[str, str], settings: SynthesizeSettings) -> set[str]:
    chosen: set[str] = set()
    for name in SPLITS:
        members = sorted(sound for sound, where in split.items() if where == name)
        if not members:
            raise InputError(
                f"synthesize.clips: should be enough for every split ({name} has none), got {settings.clips}"
            )
        if name in ("test", "unseen"):
            random = plan.generator(settings.seed, "takes", SPLITS.index(name))
            count = min(settings.multi_take_sounds, len(members))
            chosen.update(str(sound) for sound in random.choice(members, count, replace=False))
    return chosen


def perform_sound(root: Path, settings: SynthesizeSettings, order: Order) -> list[Clip]:
    """Perform the takes of one sound; write what was true and what was seen, return the rows of the index."""
    corpus, sound = Corpus(root), order.said.sound
    speaker = plan.speaker_of(settings, sound)
    identity = head_shape(speaker.identity, settings.camera)
    clips = []
    for number in range(order.takes):
        clip = _row(order, number, settings.fps)
        annotation, speech = corpus.annotation(clip), corpus.speech(clip)
        random = plan.generator(settings.seed, "motion", sound.index, number)
        take = perform(annotation, speaker.style, clip.seconds, random, settings.blink_profile)
        motion = take.motion(settings.fps, int(len(speech) * settings.fps) // SAMPLE_RATE)
        random = plan.generator(settings.seed, "noise", sound.index, number)
        seen = observe(motion, make_camera(settings.camera, random), settings.noise, random, identity)
        corpus.write_clip(clip.id, seen, motion, take.events)
        clips.append(replace(clip, content_hash=_content_hash(speech, motion)))
    return clips


def _row(order: Order, take: int, fps: float) -> Clip:
    said = order.said
    return Clip(
        id=f"{said.sound.id}-t{take}",
        sound=said.sound.id,
        take=take,
        speaker=plan.speaker_name(said.sound.speaker),
        split=order.split,
        seconds=said.seconds,
        fps=fps,
        emotion="neutral",
        intensity=0,
        language=said.language,
        text=said.text,
        source="talkingeyes synthesize",
        licence="CC0-1.0",
        content_hash="",
    )


def _content_hash(sound: Float[ndarray, " N"], motion: Motion) -> str:
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
