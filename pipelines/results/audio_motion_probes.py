"""Probes of the relation between speech and motion, for the pages of reference ranges. Not a command.

Probes are ridge regressions from speech features, tested on each speaker after training on all others. Towers are
contrastive networks like the critics, which distinguish the right sound from other sounds of the speaker. Reads
data/embed, and the true (or fitted) motion of the corpus.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Normaliser, Recording
from talkingeyes.corpus.store import shard_path
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.measures.critic import ChannelSelection
from talkingeyes.evaluation.measures.pooled import no_measurement
from talkingeyes.evaluation.reference_ranges import probes
from talkingeyes.evaluation.reference_ranges.corpus_inputs import CorpusInputs, reference_motion
from talkingeyes.evaluation.reference_ranges.measurements import Measurements
from talkingeyes.evaluation.reference_ranges.probes import (
    MIN_WINDOWS,
    SimilarityMatrix,
    matching_auc,
    permutation_p_value,
    train_similarity,
)
from talkingeyes.orchestration.run import parallel_map

MAX_CLIPS = 600
PROSODY = ("energy_dbfs", "f0_octaves", "voicing")
TRAIN, JUDGED = ("train",), ("test", "unseen")
PROBES = ("eye_r2", "head_r2", "averted_auc")
MATCHING = ("matching_auc_space", "matching_auc_gaze", "matching_p_gaze", "matching_auc_jaw")


@dataclass(frozen=True)
class ProbeData:
    """Speech features and regression targets, for all frames of one speaker."""

    features: Float[ndarray, "T F"]
    targets: Float[ndarray, "T K"]


def probe_data(corpus_inputs: CorpusInputs, clips: Sequence[Clip]) -> ProbeData:
    """Data of the clips of one speaker; angles are relative to the mean of their motion."""
    normal = Normaliser.of(corpus_inputs.embed)
    prosodic = [normal.channels.index(name) for name in PROSODY]
    features, targets = [], []
    for clip in clips:
        motion = reference_motion(corpus_inputs, clip)
        speech = np.load(shard_path(corpus_inputs.embed / "speech", clip.sound, ".npy"))
        frames = min(len(speech), len(motion))
        seen = behaviour(motion.fps, {"head": motion.head, "gaze": motion.gaze}, motion.valid)
        angles = np.concatenate([seen.eye_rad.mean(axis=1), motion.head], axis=1)[:frames]
        averted = seen.states.averted[:frames, None] - 0.5
        standard = (speech[:frames] - normal.mean) / np.maximum(normal.std, 1e-6)
        features.append(probes.with_context(standard, prosodic, motion.fps))
        targets.append(np.concatenate([angles - angles.mean(axis=0), averted], axis=1))
    return ProbeData(np.concatenate(features), np.concatenate(targets))


def speaker_gram(corpus_inputs: CorpusInputs, clips: Sequence[Clip]) -> probes.GramMatrices:
    """Sufficient statistics of one speaker for training a probe."""
    speaker = probe_data(corpus_inputs, clips)
    return probes.gram_matrices(speaker.features, speaker.targets)


def score_speaker(corpus_inputs: CorpusInputs, work: tuple[Sequence[Clip], Float[ndarray, "F K"]]) -> probes.ProbeScore:
    """Score of the probe trained on all other speakers, for one speaker."""
    clips, weights = work
    speaker = probe_data(corpus_inputs, clips)
    return probes.score_probe(speaker.features, speaker.targets, weights)


def measure_probes(corpus_inputs: CorpusInputs, clips: Sequence[Clip], jobs: int) -> Measurements:
    """Leave-one-speaker-out ridge regression from speech."""
    by_speaker: dict[str, list[Clip]] = {}
    for clip in clips:
        by_speaker.setdefault(clip.speaker, []).append(clip)
    if len(by_speaker) < 3:
        few = no_measurement(f"too few speakers: got {len(by_speaker)}, needs 3")
        return dict.fromkeys(PROBES, few)
    people = list(by_speaker.values())
    grams = list(parallel_map(partial(speaker_gram, corpus_inputs), people, jobs, "reference ranges: fit probes"))
    work = [(mine, probes.fit_ridge(grams[:index] + grams[index + 1 :])) for index, mine in enumerate(people)]
    return probes.measure_probes(
        list(parallel_map(partial(score_speaker, corpus_inputs), work, jobs, "reference ranges: score probes"))
    )


def recording(corpus_inputs: CorpusInputs, clip: Clip, part: str) -> Recording:
    """Speech features and motion of a clip; for towers of the jaw, the jaw replaces the head."""
    motion = reference_motion(corpus_inputs, clip)
    speech = np.load(shard_path(corpus_inputs.embed / "speech", clip.sound, ".npy"), mmap_mode="r")
    frames = min(len(speech), len(motion))
    turned = motion.jaw if part == "jaw" else motion.head
    head, gaze = (np.asarray(angles[:frames], np.float32) for angles in (turned, motion.gaze))
    return Recording(clip, speech[:frames], head, gaze, motion.valid[:frames])


def tower_clips(corpus_inputs: CorpusInputs) -> tuple[list[Clip], list[Clip]]:
    """The clips that towers are trained on, and those that they are tested on."""
    corpus = corpus_inputs.corpus
    return corpus.select(*TRAIN)[:MAX_CLIPS], corpus.select(*JUDGED, take=0)


def train_tower(corpus_inputs: CorpusInputs, part: str) -> SimilarityMatrix:
    """Train and evaluate the towers of one part."""
    content = json.loads((corpus_inputs.embed / "embedding.json").read_text())
    train_recordings, judged_recordings = (
        [recording(corpus_inputs, clip, part) for clip in clips] for clips in tower_clips(corpus_inputs)
    )
    channel_selection = ChannelSelection.of(content, corpus_inputs.critic.channels)
    return train_similarity(
        "head" if part == "jaw" else part, train_recordings, judged_recordings, channel_selection, corpus_inputs.critic
    )


def reason_against_towers(corpus_inputs: CorpusInputs) -> str:
    """Why towers cannot be tested on these splits; empty if they can. Wrong sounds are of the same speaker."""
    speakers = Counter(clip.speaker for clip in tower_clips(corpus_inputs)[1])
    comparable = sum(count for count in speakers.values() if count > 1)
    if comparable < MIN_WINDOWS:
        return f"too few sounds of speakers with several: got {comparable}, needs {MIN_WINDOWS}"
    return ""


def measure_towers(corpus_inputs: CorpusInputs, jobs: int) -> Measurements:
    """AUC of right against wrong sounds, of gaze and head, and of the jaw."""
    if reason := reason_against_towers(corpus_inputs):
        return dict.fromkeys(MATCHING, no_measurement(reason))
    task = partial(train_tower, corpus_inputs)
    parts = ["gaze_in_space", "head", "jaw"]
    found = dict(zip(parts, parallel_map(task, parts, jobs, "reference ranges: towers"), strict=True))
    space, both = found["gaze_in_space"], found["gaze_in_space"] + found["head"]
    return {
        "matching_auc_space": matching_auc(space),
        "matching_auc_gaze": matching_auc(both),
        "matching_p_gaze": permutation_p_value(both, seed=0),
        "matching_auc_jaw": matching_auc(found["jaw"]),
    }
