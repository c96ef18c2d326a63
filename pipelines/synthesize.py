"""Stage `synthesize`: a synthetic corpus of spoken text with true motion and what a camera sees of it.

Reads   nothing (text, voices and motion are the project's own)
Writes  data/synthesize/: clips.parquet, speech/, partner/, annotations/, observations/, truth/ (docs/conventions.md),
        table1.md
Run     python -m pipelines.synthesize

Splits are known before anything is said: 15 % of the speakers are unseen, the sounds of the rest are dealt 8:1:1. Some
sounds of test and unseen have several takes: one sound, motion drawn again, for the one-to-many tests. A run that is
cut off goes on with the sound that it was at.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import SPLITS, Clip
from talkingeyes.corpus.splits import split_sounds
from talkingeyes.corpus.store import Corpus, sharded, sharded_for_writing
from talkingeyes.corpus.table1 import row_of, table
from talkingeyes.orchestration.run import Report, Workspace, code_digest, each, main
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.acoustics import heard
from talkingeyes.synthesis.observations import head_shape, make_camera, observe
from talkingeyes.synthesis.plan import Sound, SynthesizeSettings
from talkingeyes.synthesis.take import perform
from talkingeyes.synthesis.text import TextShare
from talkingeyes.synthesis.voices import Spoken, converse

# The code that a corpus is made by: a run that was cut off goes on only under the same.
ROOMS = ("audio", "core", "corpus", "head", "physiology", "synthesis")


# Each split has a share of all text to itself, so no sentence occurs in two of them.
TEXT = {
    "train": TextShare(0.0, 0.64),
    "val": TextShare(0.64, 0.76),
    "test": TextShare(0.76, 0.88),
    "unseen": TextShare(0.88, 1.0),
}


@dataclass(frozen=True)
class Order:
    """A sound to speak and perform, in its split, so many times."""

    sound: Sound
    split: str
    takes: int


def run(workspace: Workspace) -> Report:
    """Speak and perform all sounds."""
    settings = workspace.settings("synthesize", SynthesizeSettings)
    wanted = orders(settings)
    with workspace.output("synthesize", made_of=f"{settings.model_dump_json()} {code_digest(ROOMS)}") as folder:
        made = each(partial(make_sound, folder, settings), wanted, workspace.jobs, "synthesize")
        clips = [clip for takes in made for clip in takes]
        shutil.rmtree(folder / "rows")
        Corpus(folder).write_index(clips)
        row = table("synthesize", row_of(clips), "synthesised")
        (folder / "table1.md").write_text(row)
    print(row, end="")
    return Report(metrics=_summary(clips))


def orders(settings: SynthesizeSettings) -> list[Order]:
    """All sounds with their splits and takes. Raises InputError when a split stays empty."""
    sounds = plan.sounds(settings)
    speaker_of = {sound.id: plan.speaker_name(sound.speaker) for sound in sounds}
    split = split_sounds(speaker_of, dict.fromkeys(speaker_of, ()), settings.seed)
    several = _with_takes(split, settings)
    return [Order(sound, split[sound.id], settings.takes if sound.id in several else 1) for sound in sounds]


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


def make_sound(root: Path, settings: SynthesizeSettings, order: Order) -> list[Clip]:
    """One sound with all its takes, written; its rows of the index. What an earlier run finished is taken as it is."""
    rows = sharded(root / "rows", order.sound.id, ".json")
    if rows.exists():
        return [Clip(**row) for row in json.loads(rows.read_text())]
    spoken = say_sound(root, settings, order)
    clips = perform_sound(root, settings, order, spoken)
    unfinished = sharded_for_writing(root / "rows", order.sound.id, ".unfinished")
    unfinished.write_text(json.dumps([asdict(clip) for clip in clips]))
    unfinished.replace(rows)
    return clips


def say_sound(root: Path, settings: SynthesizeSettings, order: Order) -> Spoken:
    """Speak one sound and write it with its annotation; noise and room change what is written, not what is known."""
    sound = order.sound
    source = settings.sources[sound.source]
    random = plan.generator(settings.seed, "sound", sound.index)
    cast, share = plan.cast_of(settings, sound), TEXT[order.split]
    spoken = converse(cast, source.shortest_s, source.longest_s, random, share)
    random = plan.generator(settings.seed, "acoustics", sound.index)
    spoken = replace(
        spoken,
        sound=heard(spoken.sound, settings.acoustics, random),
        annotation=replace(spoken.annotation, emotion=sound.emotion, intensity=sound.intensity),
        partner=None if spoken.partner is None else heard(spoken.partner, settings.acoustics, random),
    )
    Corpus(root).write_sound(sound.id, spoken.sound, spoken.annotation, spoken.partner)
    return spoken


def perform_sound(root: Path, settings: SynthesizeSettings, order: Order, spoken: Spoken) -> list[Clip]:
    """Perform the takes of one sound; write what was true and what was seen, return the rows of the index."""
    sound = order.sound
    speaker = plan.speaker_of(settings, sound)
    identity = head_shape(speaker.identity, settings.camera)
    clips = []
    for number in range(order.takes):
        clip = _row(order, spoken, number, settings.fps)
        random = plan.generator(settings.seed, "motion", sound.index, number)
        take = perform(spoken.annotation, speaker.style, clip.seconds, random, settings.blink_profile)
        motion = take.motion(settings.fps, int(len(spoken.sound) * settings.fps) // SAMPLE_RATE)
        random = plan.generator(settings.seed, "noise", sound.index, number)
        seen = observe(motion, make_camera(settings.camera, random), settings.noise, random, identity)
        Corpus(root).write_clip(clip.id, seen, motion, take.events)
        clips.append(replace(clip, content_hash=_content_hash(spoken.sound, motion)))
    return clips


def _row(order: Order, spoken: Spoken, take: int, fps: float) -> Clip:
    sound = order.sound
    return Clip(
        id=f"{sound.id}-t{take}",
        sound=sound.id,
        take=take,
        speaker=plan.speaker_name(sound.speaker),
        split=order.split,
        seconds=spoken.seconds,
        fps=fps,
        emotion=sound.emotion,
        intensity=sound.intensity,
        language=spoken.script.language,
        text=spoken.text,
        source=f"synthetic {sound.source}",
        licence="CC0-1.0",
        content_hash="",
    )


def _content_hash(sound: Float[ndarray, " N"], motion: Motion) -> str:
    content = hashlib.blake2b(digest_size=16)
    for array in (sound, motion.head, motion.gaze, motion.lid, motion.jaw, motion.expression):
        content.update(np.ascontiguousarray(array, np.float32).tobytes())
    return content.hexdigest()


def _summary(clips: list[Clip]) -> dict[str, float]:
    sounds = {clip.sound: clip.seconds for clip in clips}
    counts = {f"sounds/{name}": float(len({c.sound for c in clips if c.split == name})) for name in SPLITS}
    return {**counts, "clips": float(len(clips)), "minutes": sum(sounds.values()) / 60.0}


if __name__ == "__main__":
    main(run)
