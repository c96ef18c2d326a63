"""Timing of gaze beside recorded conversations: the first table of docs/results/people.md, and the direct test.

Run     python -m pipelines.results.people_timing [CONTACT TURNS]        (an hour of one core; resumable)
Reads   CONTACT and TURNS (../shared/data/real/gaze/face_to_face_*.csv.gz); data/synthesize and data/sample of the chain
        (after make repro); without them, synthesizes conversations and samples the packaged models in build/timing
Writes  docs/results/people_timing.json, and with people.json docs/results/people.md

The table is what `talkingeyes evaluate MOTIONS --people CONTACT --turns TURNS --reference CORPUS` prints, with more
rows. The direct test lays synthetic speech on the recorded turns, samples each model and the rules of `synthesize`, and
asks how likely the recorded aversions are under them (evaluation/people/aversion_likelihood.py). Not a stage: the
recordings are no part of the project.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.results import people
from pipelines.synthesize import sound_jobs, synthesize_sound
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.inference.motion import NumpyMotionGenerator
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, PACKAGED_MODEL
from talkingeyes.animation.torch_generation import sample_motion
from talkingeyes.audio.encoder import EmbedSettings, SpeechEncoder, make_encoder
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_json, read_yaml
from talkingeyes.core.errors import InputError
from talkingeyes.core.progress import progress_bar
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_files import MotionFields
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.people.aversion_likelihood import likelihood_gains
from talkingeyes.evaluation.people.conversations import RATE_HZ, ConversationGaze, Turns, read_conversations
from talkingeyes.evaluation.people.timing import turn_information
from talkingeyes.models.condition.random_speaker import random_speaker
from talkingeyes.models.replay import ReplayBank, ReplaySettings, sample_replay
from talkingeyes.orchestration.config import CONFIG_DIR, compose
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command
from talkingeyes.physiology.blinks import PROFILES
from talkingeyes.synthesis.plan import SynthesizeSettings
from talkingeyes.synthesis.speakers import sample_speaker
from talkingeyes.synthesis.speech_synthesis import DialogueVoices, SynthesizedSpeech, synthesize_turns
from talkingeyes.synthesis.take import sample_take
from talkingeyes.synthesis.voice_profiles import sample_voice
from talkingeyes.workflows.evaluate import CONFIDENCE_LEVEL
from talkingeyes.workflows.evaluate_people import MOTIONS
from talkingeyes.workflows.evaluate_timing import evaluate_timing, motion_gaze

RECORDED = people.RECORDED.parent
CONTACT, TURNS = RECORDED / "face_to_face_contact.csv.gz", RECORDED / "face_to_face_turns.csv.gz"
BUILD = Path("build/timing")
# Of the chain, clips are short and few have a partner; without it, conversations of a minute.
CONVERSATIONS = [
    f"workspace={BUILD}",
    "embed=logmel",  # of the lookups, which see loudness and speech alone
    "synthesize.clips=96",
    "synthesize.speakers=32",
    "synthesize.shortest_s=58",
    "synthesize.longest_s=62",
    "synthesize.dialogue_share=1",
    "synthesize.multi_take_sounds=0",
    "synthesize.seed=84",
    "synthesize.splits.unseen_speakers=0.3",
    "synthesize.splits.test=0.2",
    "synthesize.splits.val=0.05",
]
MODELS = {"default": PACKAGED_MODEL, "live": PACKAGED_LIVE_MODEL}
CHAIN = {"default": "talkingeyes_events", "live": "talkingeyes_live"}
LOOKUPS = ("aligned_replay", "pieced_replay")
SAMPLES = 4  # of each sound of the corpus
# Of the direct test: samples for each person, of so many training speakers; the first seconds of each pair.
TURN_SAMPLES, SPEAKERS, STRETCH_S = 16, 2, 120.0
SETTINGS = BootstrapSettings(n_resamples=1000, confidence_level=CONFIDENCE_LEVEL, seed=0)
FPS = 25.0


def conversation_corpus(workspace: Workspace) -> Corpus:
    """Synthetic conversations; those of an earlier run are kept."""
    settings = workspace.settings("synthesize", SynthesizeSettings)
    if not (workspace.corpus / "clips.parquet").is_file():
        with workspace.output("synthesize") as folder:
            made = parallel_map(
                partial(synthesize_sound, folder, settings), sound_jobs(settings), workspace.jobs, "conversations"
            )
            Corpus(folder).write_index([clip for takes in made for clip in takes])
            shutil.rmtree(folder / "rows")
    return Corpus(workspace.corpus)


def sample(
    animator: Animator, embedding: Float[ndarray, "T C"], sound: Float[ndarray, " N"], seeds: list[int]
) -> Samples:
    """Motions of a model alone, as a random training speaker that the first seed draws."""
    speakers = animator.persons
    speaker = random_speaker(speakers, [seeds[0]]) if speakers else None
    if isinstance(animator.generator, NumpyMotionGenerator):
        return animator.generator.generate(embedding, seeds, FPS, speaker)
    return sample_motion(animator.generator, embedding, sound, seeds, FPS, speaker)


def sample_models(corpus: Corpus, folder: Path) -> dict[str, Path]:
    """Samples of the packaged models and of the lookups for all test and unseen sounds; a folder a row."""
    clips = corpus.select("test", "unseen", take=0)
    rows = {name: folder / name for name in (*MODELS, *LOOKUPS)}
    seeds = {
        clip.id: np.random.default_rng([*clip.id.encode()]).integers(2**31, size=SAMPLES).tolist() for clip in clips
    }

    def unsampled(names: Iterable[str]) -> list[Clip]:
        return [clip for clip in clips if not all(shard_path(rows[name], clip.id, ".npz").is_file() for name in names)]

    animators = {name: Animator.load(path) for name, path in MODELS.items()}
    for clip in progress_bar(unsampled(MODELS), "sample"):
        sound = corpus.speech(clip)
        embedding = encode(animators, sound)
        for name, animator in animators.items():
            found = sample(animator, embedding, sound, seeds[clip.id])
            found.save(make_shard_path(rows[name], clip.id, ".npz"))
    if wanted := unsampled(LOOKUPS):
        encoder = make_encoder(Workspace(BUILD, compose(CONVERSATIONS)).settings("embed", EmbedSettings))
        conf, bank = read_yaml(CONFIG_DIR / "model/aligned_replay.yaml", "model"), _bank(corpus, encoder)
        for clip in progress_bar(wanted, "lookup"):
            embedding = encoder(corpus.speech(clip), FPS)
            for name in LOOKUPS:
                settings = ReplaySettings.model_validate(conf | {"kind": name})
                motion = sample_replay(settings, bank, embedding, seeds[clip.id]).astype(float)
                gaze = motion[..., 3:].reshape(*motion.shape[:2], 2, 3)
                Samples(FPS, motion[..., :3], gaze).save(make_shard_path(rows[name], clip.id, ".npz"))
    return rows


def _bank(corpus: Corpus, encoder: SpeechEncoder) -> ReplayBank:
    clips = corpus.select("train", take=0)
    speech, motions = [], []
    for clip in clips:
        truth, features = corpus.truth(clip), encoder(corpus.speech(clip), FPS)
        frames = min(len(truth), len(features))
        motion = np.concatenate([truth.head, truth.gaze.reshape(len(truth), 6)], axis=1)
        speech.append(features[:frames])
        motions.append(motion[:frames])
    return ReplayBank.of(speech, motions, encoder.channels, FPS)


def turn_shares(folder: Path, persons: Mapping[str, Turns]) -> dict[str, list[Float[ndarray, " T"]]]:
    """The share of samples that are averted, by row and person, under speech that is laid on the recorded turns."""
    animators = {name: Animator.load(path) for name, path in MODELS.items()}
    rows: dict[str, list[ndarray]] = {name: [] for name in (*MODELS, "rules")}
    for index, (name, turns) in enumerate(progress_bar(persons.items(), "turns", len(persons))):
        path = folder / f"{name}.npz"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            rng = np.random.default_rng([84, index])
            voices = DialogueVoices(sample_voice(rng, "en"), sample_voice(rng, "en"))
            spoken = synthesize_turns(voices, (turns.own, turns.partner), STRETCH_S, rng)
            embedding = encode(animators, spoken.sound)
            shares: dict[str, Any] = {"rules": rules_share(spoken, rng)}
            shares |= {model: model_share(each, embedding, spoken.sound, index) for model, each in animators.items()}
            np.savez(path.with_suffix(".unfinished.npz"), **shares)
            path.with_suffix(".unfinished.npz").replace(path)
        with np.load(path) as file:
            for row, found in rows.items():
                found.append(file[row])
    # The gaze of the rules under the turns of another pair.
    rows["random"] = [*rows["rules"][1:], *rows["rules"][:1]]
    return rows


def encode(animators: Mapping[str, Animator], sound: Float[ndarray, " N"]) -> Float[ndarray, "T C"]:
    """Speech features of a sound; the packaged models share one encoder."""
    first, *others = animators.values()
    assert all(each.encoder.channels == first.encoder.channels for each in others)
    return first.encoder(sound, FPS)


def model_share(
    animator: Animator, embedding: Float[ndarray, "T C"], sound: Float[ndarray, " N"], index: int
) -> Float[ndarray, " T"]:
    """The share of TURN_SAMPLES samples of a model that are averted."""
    each = TURN_SAMPLES // SPEAKERS
    states = []
    for speaker in range(SPEAKERS):
        seeds = np.random.default_rng([84, index, speaker]).integers(2**31, size=each).tolist()
        found = sample(animator, embedding, sound, seeds)
        states += [_averted(head, gaze) for head, gaze in zip(found.head, found.gaze, strict=True)]
    return np.asarray(np.mean(states, axis=0))


def rules_share(spoken: SynthesizedSpeech, rng: np.random.Generator) -> Float[ndarray, " T"]:
    """The share of TURN_SAMPLES takes of `synthesize` that are averted, each of another speaker."""
    states, profile = [], PROFILES["physiological"]
    for _ in range(TURN_SAMPLES):
        style = sample_speaker("any", "en", rng, profile, 1.0, ()).style
        motion = sample_take(spoken.annotation, style, spoken.seconds, rng, profile).motion(
            FPS, round(spoken.seconds * FPS)
        )
        states.append(_averted(motion.head, motion.gaze))
    return np.asarray(np.mean(states, axis=0))


def _averted(head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"]) -> ndarray:
    motion = MotionFields(FPS, {"head": head, "gaze": gaze}, None)
    return motion_gaze(motion, "", Turns((), ())).averted


def compute(contact: Path, turns: Path) -> dict[str, Any]:
    """The table and the direct test."""
    recorded = read_conversations(contact, turns)
    chain = {name: Path("data/sample") / folder for name, folder in CHAIN.items()}
    if all(folder.is_dir() for folder in chain.values()):
        reference, groups = Path("data/synthesize"), chain
        groups |= {name: path for name in LOOKUPS if (path := Path("data/sample") / name).is_dir()}
    else:
        corpus = conversation_corpus(Workspace(BUILD, compose(CONVERSATIONS)))
        reference, groups = corpus.root, sample_models(corpus, BUILD / "sample")
    first, *others = groups
    timing = evaluate_timing(
        groups[first], contact, turns, reference=reference, others={name: groups[name] for name in others}
    ).content | {"notes": []}
    timing["rows"] = {first if name == MOTIONS else name: row for name, row in timing["rows"].items()}
    # One person of each pair.
    chosen = {
        coder: [each[index + index // 2 % 2] for index in range(0, len(each), 2)] for coder, each in recorded.items()
    }
    one = next(iter(chosen.values()))
    rows = turn_shares(BUILD / "turns", {each.unit: each.turns for each in one})
    frames = round(STRETCH_S * RATE_HZ)
    likelihood = {}
    for coder, each in chosen.items():
        cut = [replace(gaze, averted=gaze.averted[:frames], known=gaze.known[:frames]) for gaze in each]
        likelihood[coder] = {"turns": {"shifted": asdict(turn_information(cut, SETTINGS))}} | {
            row: {name: asdict(found) for name, found in _gains(cut, shares).items()} for row, shares in rows.items()
        }
    return timing | {
        "likelihood": likelihood,
        "direct_test": {"pairs": len(one), "samples": TURN_SAMPLES, "seconds": STRETCH_S},
    }


def _gains(gazes: Sequence[ConversationGaze], shares: Sequence[Float[ndarray, " T"]]) -> Mapping[str, Any]:
    return likelihood_gains(gazes, shares, TURN_SAMPLES, SETTINGS)


def main() -> None:
    """Measure, and write the page."""
    contact, turns = map(Path, sys.argv[1:3]) if len(sys.argv) > 2 else (CONTACT, TURNS)
    for path in (contact, turns):
        if not path.is_file():
            raise InputError(
                f"{path}: should be a table of recorded people, got none (docs/results/people.md says where)"
            )
    content = compute(contact, turns)
    numbers = read_json(people.DOCS / "people.json", "result")
    for name, text in (
        ("people_timing.json", json.dumps(content, indent=1) + "\n"),
        ("people.md", people.page(numbers, content)),
    ):
        with atomic_write(people.DOCS / name) as path:
            path.write_text(text)


if __name__ == "__main__":
    run_command(main)
