"""How much the sound of a corpus says of its motion: probes and towers of `make facts`. No command of its own.

Probes are ridge regressions from features of speech, each speaker told by what was learnt from all others; towers tell
right from wrong sounds of a speaker, as the critics do. Reads data/embed and the true motion.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import sharded
from talkingeyes.corpus.windows import Normaliser, Recording
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.contrast import Hearing
from talkingeyes.evaluation.facts import probes
from talkingeyes.evaluation.facts.clip import missing
from talkingeyes.evaluation.facts.figures import Figures
from talkingeyes.evaluation.facts.matching import Similar
from talkingeyes.evaluation.facts.source import Source, motion_of
from talkingeyes.orchestration.run import each

MOST_CLIPS = 600
PROSODY = ("energy_dbfs", "f0_octaves", "voicing")


@dataclass(frozen=True)
class Probed:
    """Features of speech and what is to be told from them, for all frames of one speaker."""

    features: Float[ndarray, "T F"]
    targets: Float[ndarray, "T K"]


def probed(source: Source, clips: Sequence[Clip]) -> Probed:
    """Of the clips of one speaker; angles about the mean of their clip."""
    normal = Normaliser.of(source.embed)
    prosodic = [normal.channels.index(name) for name in PROSODY]
    features, targets = [], []
    for clip in clips:
        motion = motion_of(source, clip)
        speech = np.load(sharded(source.embed / "speech", clip.sound, ".npy"))
        frames = min(len(speech), len(motion))
        seen = behaviour(motion.fps, {"head": motion.head, "gaze": motion.gaze}, motion.valid)
        angles = np.concatenate([seen.eye_rad.mean(axis=1), motion.head], axis=1)[:frames]
        averted = seen.states.averted[:frames, None] - 0.5
        standard = (speech[:frames] - normal.mean) / np.maximum(normal.std, 1e-6)
        features.append(probes.with_surroundings(standard, prosodic, motion.fps))
        targets.append(np.concatenate([angles - angles.mean(axis=0), averted], axis=1))
    return Probed(np.concatenate(features), np.concatenate(targets))


def gram_of(source: Source, clips: Sequence[Clip]) -> probes.Gram:
    """All that learning a probe needs of one speaker."""
    speaker = probed(source, clips)
    return probes.gram(speaker.features, speaker.targets)


def told_of(source: Source, work: tuple[Sequence[Clip], Float[ndarray, "F K"]]) -> probes.Told:
    """What the probe learnt from others tells of one speaker."""
    clips, weights = work
    speaker = probed(source, clips)
    return probes.told(speaker.features, speaker.targets, weights)


def of_probes(source: Source, clips: Sequence[Clip], jobs: int) -> Figures:
    """Ridge regression from sound, each speaker told by what was learnt from all others."""
    by_speaker: dict[str, list[Clip]] = {}
    for clip in clips:
        by_speaker.setdefault(clip.speaker, []).append(clip)
    if len(by_speaker) < 3:
        few = missing(f"too few speakers: {len(by_speaker)}, 3 are needed")
        return dict.fromkeys(("eye_r2", "head_r2", "averted_auc"), few)
    people = list(by_speaker.values())
    grams = list(each(partial(gram_of, source), people, jobs, "facts: probes learn"))
    work = [(mine, probes.learn(grams[:index] + grams[index + 1 :])) for index, mine in enumerate(people)]
    return probes.of_probes(list(each(partial(told_of, source), work, jobs, "facts: probes tell")))


def recording(source: Source, clip: Clip, part: str) -> Recording:
    """Speech features and true motion of a clip; the jaw takes the head's place for towers of the jaw."""
    motion = motion_of(source, clip)
    speech = np.load(sharded(source.embed / "speech", clip.sound, ".npy"), mmap_mode="r")
    frames = min(len(speech), len(motion))
    turned = motion.jaw if part == "jaw" else motion.head
    head, gaze = (np.asarray(angles[:frames], np.float32) for angles in (turned, motion.gaze))
    return Recording(clip, speech[:frames], head, gaze, motion.valid[:frames])


def tower(source: Source, part: str) -> Similar:
    """Train and judge the towers of one part."""
    from talkingeyes.evaluation.facts.matching import similarities

    content = json.loads((source.embed / "embedding.json").read_text())
    train = source.corpus.select("train")[:MOST_CLIPS]
    judged = source.corpus.select("test", "unseen", take=0)
    train_recordings, judged_recordings = (
        [recording(source, clip, part) for clip in clips] for clips in (train, judged)
    )
    hearing = Hearing.of(content, source.critic.channels)
    return similarities("head" if part == "jaw" else part, train_recordings, judged_recordings, hearing, source.critic)


def of_towers(source: Source, jobs: int) -> Figures:
    """Right against wrong sounds."""
    from talkingeyes.evaluation.facts.matching import by_chance, matched

    space, head, jaw = each(partial(tower, source), ("space", "head", "jaw"), jobs, "facts: towers")
    both = space + head
    return {
        "match_space": matched(space),
        "match_gaze": matched(both),
        "match_gaze_p": by_chance(both, seed=0),
        "match_jaw": matched(jaw),
    }
