"""Stage `synthesize`: a synthetic corpus of spoken text with true motion and simulated camera observations.

Reads   nothing (text, voices and motion are the project's own)
Writes  data/synthesize/: clips.parquet, speech/, partner/, annotations/, observations/, truth/ (docs/conventions.md),
        table1.md
Run     python -m pipelines.synthesize

Splits are assigned before speech is synthesized. Some sounds of test and unseen have several takes, with resampled
motion for one sound, for the one-to-many tests. An interrupted run resumes with the sound at which it stopped.
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

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import SPLITS, Clip
from talkingeyes.corpus.splits import split_sounds
from talkingeyes.corpus.statistics import corpus_statistics, statistics_table
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.head.observation import Observation
from talkingeyes.orchestration.run import Report, Workspace, code_digest, main, parallel_map
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.acoustics import apply_acoustics
from talkingeyes.synthesis.observations import identity_weights, make_camera, observe
from talkingeyes.synthesis.plan import PlannedSound, SynthesizeSettings
from talkingeyes.synthesis.speech_synthesis import SynthesizedSpeech, synthesize_conversation
from talkingeyes.synthesis.take import sample_take
from talkingeyes.synthesis.text import TextPartition

# Code that a corpus depends on: an interrupted run resumes only with the same code.
SOURCE_MODULES = ("audio", "core", "corpus", "head", "physiology", "synthesis")


# Takes of every sound of val: the second one shows how near two true motions are, beside the distances that models are
# chosen by.
VAL_TAKES = 2
# Each split has its own part of the text, so no sentence occurs in two splits.
SPLIT_PARTITIONS = {
    "train": TextPartition(0.0, 0.64),
    "val": TextPartition(0.64, 0.76),
    "test": TextPartition(0.76, 0.88),
    "unseen": TextPartition(0.88, 1.0),
}


@dataclass(frozen=True)
class SoundJob:
    """A sound to synthesize, its split and its number of takes."""

    sound: PlannedSound
    split: str
    takes: int


def run(workspace: Workspace) -> Report:
    """Synthesize speech and motion of all sounds."""
    settings = workspace.settings("synthesize", SynthesizeSettings)
    wanted = sound_jobs(settings)
    with workspace.output(
        "synthesize", fingerprint=f"{settings.model_dump_json()} {code_digest(SOURCE_MODULES)}"
    ) as folder:
        made = parallel_map(partial(synthesize_sound, folder, settings), wanted, workspace.jobs, "synthesize")
        clips = [clip for takes in made for clip in takes]
        shutil.rmtree(folder / "rows")
        Corpus(folder).write_index(clips)
        row = statistics_table("synthesize", corpus_statistics(clips), "synthesised")
        (folder / "table1.md").write_text(row)
    print(row, end="")
    return Report(metrics=_summary(clips))


def sound_jobs(settings: SynthesizeSettings) -> list[SoundJob]:
    """All sounds with their splits and takes. Raises InputError if a split is empty."""
    sounds = plan.plan_sounds(settings)
    speaker_of = {sound.id: plan.speaker_name(sound.speaker) for sound in sounds}
    split = split_sounds(speaker_of, dict.fromkeys(speaker_of, ()), settings.seed, **settings.splits.model_dump())
    takes = _takes(split, settings)
    return [SoundJob(sound, split[sound.id], takes[sound.id]) for sound in sounds]


def _takes(split: Mapping[str, str], settings: SynthesizeSettings) -> dict[str, int]:
    """The number of takes of each sound."""
    takes = {sound: VAL_TAKES if where == "val" else 1 for sound, where in split.items()}
    for name in SPLITS:
        members = sorted(sound for sound, where in split.items() if where == name)
        if not members:
            raise InputError(
                f"synthesize.clips: should be enough for every split ({name} has none), got {settings.clips}"
            )
        if name in ("test", "unseen"):
            rng = plan.seeded_generator(settings.seed, "takes", SPLITS.index(name))
            count = min(settings.multi_take_sounds, len(members))
            takes |= dict.fromkeys(map(str, rng.choice(members, count, replace=False)), settings.takes)
    return takes


def synthesize_sound(root: Path, settings: SynthesizeSettings, job: SoundJob) -> list[Clip]:
    """Write one sound with all its takes; returns its rows of the index. A sound finished by an earlier run is
    reused."""
    rows = shard_path(root / "rows", job.sound.id, ".json")
    if rows.exists():
        return [Clip(**row) for row in json.loads(rows.read_text())]
    spoken = synthesize_speech(root, settings, job)
    clips = synthesize_takes(root, settings, job, spoken)
    unfinished = make_shard_path(root / "rows", job.sound.id, ".unfinished")
    unfinished.write_text(json.dumps([asdict(clip) for clip in clips]))
    unfinished.replace(rows)
    return clips


def synthesize_speech(root: Path, settings: SynthesizeSettings, job: SoundJob) -> SynthesizedSpeech:
    """Synthesize one sound and write it with its annotation. Noise and room change the sound, not the annotation."""
    sound = job.sound
    source = settings.sources[sound.source]
    rng = plan.seeded_generator(settings.seed, "sound", sound.index)
    speaker_voices, partition = plan.dialogue_voices(settings, sound), SPLIT_PARTITIONS[job.split]
    spoken = synthesize_conversation(speaker_voices, source.shortest_s, source.longest_s, rng, partition)
    rng = plan.seeded_generator(settings.seed, "acoustics", sound.index)
    spoken = replace(
        spoken,
        sound=apply_acoustics(spoken.sound, settings.acoustics, rng),
        annotation=replace(spoken.annotation, emotion=sound.emotion, intensity=sound.intensity),
        partner=None if spoken.partner is None else apply_acoustics(spoken.partner, settings.acoustics, rng),
    )
    Corpus(root).write_sound(sound.id, spoken.sound, spoken.annotation, spoken.partner)
    return spoken


def synthesize_takes(root: Path, settings: SynthesizeSettings, job: SoundJob, spoken: SynthesizedSpeech) -> list[Clip]:
    """Sample the takes of one sound; write truth and observations, return the rows of the index."""
    sound = job.sound
    speaker = plan.speaker_of(settings, sound)
    identity = identity_weights(speaker.identity, settings.camera)
    clips = []
    for number in range(job.takes):
        clip = _clip_row(job, spoken, number, settings.fps)
        rng = plan.seeded_generator(settings.seed, "motion", sound.index, number)
        take = sample_take(spoken.annotation, speaker.style, clip.seconds, rng, settings.blink_profile)
        motion = take.motion(settings.fps, int(len(spoken.sound) * settings.fps) // SAMPLE_RATE)
        rng = plan.seeded_generator(settings.seed, "noise", sound.index, number)
        seen = observe(motion, make_camera(settings.camera, rng), settings.noise, rng, identity)
        Corpus(root).write_clip(clip.id, seen, motion, take.events)
        clips.append(replace(clip, content_hash=_content_hash(spoken, motion, seen)))
    return clips


def _clip_row(job: SoundJob, spoken: SynthesizedSpeech, take: int, fps: float) -> Clip:
    sound = job.sound
    return Clip(
        id=f"{sound.id}-t{take}",
        sound=sound.id,
        take=take,
        speaker=plan.speaker_name(sound.speaker),
        split=job.split,
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


def _content_hash(spoken: SynthesizedSpeech, motion: Motion, seen: Observation) -> str:
    """Digest of all files of a clip, so that the index stands for the corpus in dvc.yaml."""
    content = hashlib.blake2b(json.dumps(vars(spoken.annotation), default=vars).encode(), digest_size=16)
    arrays = [motion.head, motion.gaze, motion.lid, motion.jaw, motion.expression, seen.landmarks, seen.pupils]
    for array in (spoken.sound, *([] if spoken.partner is None else [spoken.partner]), *arrays):
        content.update(np.ascontiguousarray(array, np.float32).tobytes())
    return content.hexdigest()


def _summary(clips: list[Clip]) -> dict[str, float]:
    sounds = {clip.sound: clip.seconds for clip in clips}
    counts = {f"sounds/{name}": float(len({c.sound for c in clips if c.split == name})) for name in SPLITS}
    return {**counts, "clips": float(len(clips)), "minutes": sum(sounds.values()) / 60.0}


if __name__ == "__main__":
    main(run)
