"""Evaluation of head motion models of one seed: the paper's three measurements, ablations, new people.

Reads folders as the stages leave them: a corpus, its fitted motion, its embedding and trained models; and a second
corpus of new people who speak other languages, of which the true motion is used.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.core.containers import read_json
from talkingeyes.corpus.poses import (
    PoseRecording,
    PoseRecordings,
    PoseSettings,
    gaussian_smooth,
    pose_recordings,
    resample_cubic,
    resample_linear,
    to_poses,
)
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.papers.posegan_classifiers import (
    ClassifierSettings,
    LabelledWindows,
    PoseClassifier,
    PoseWindows,
    SVMSettings,
    acceptance_rates,
    blend_styles,
    classifier_scores,
    pose_windows,
    sliding_windows,
    train_classifier,
)
from talkingeyes.evaluation.papers.posegan_movement import (
    clip_difference,
    distances,
    jitter,
    measure_style,
    seam_speed_ratio,
    style_distance,
)
from talkingeyes.models.speech_to_pose import SHARED_FRAMES, SpeechToPose
from talkingeyes.training.checkpoint import load
from talkingeyes.training.loop import LoopSettings
from talkingeyes.training.motion_generators import pose_network
from talkingeyes.training.pose_task import movement_ratios

WINDOW_FRAMES, HOP_FRAMES, SVM_HOP = 256, 16, 32
CLASSIFIER = ClassifierSettings(
    seed=0,
    width=32,
    dropout=0.3,
    loop=LoopSettings(
        steps=400,
        batch=32,
        learning_rate=2e-3,
        schedule="one-cycle",
        weight_decay=0.01,
        clip_norm=1.0,
        validate_every=50,
    ),
)
SVM = SVMSettings(features=29, nu=0.1, seed=0)
NOISE_DB = (20.0, 10.0, 0.0)
REFERENCE_S = (4.0, 8.0, 16.0)
COST_MINUTES = 10.0


@dataclass(frozen=True)
class PoseInputPaths:
    """The corpus with the folder data/ of its models, data/ of the new people, and names of the models to evaluate."""

    corpus: Path
    data: Path
    new_speakers: Path
    generate_heads: Sequence[str]
    ablations: Sequence[str]


def evaluate_models(sources: PoseInputPaths, seed: int) -> dict[str, Any]:
    """Compute all metrics as plain numbers by name."""
    data = sources.data
    networks = {
        name: pose_network(load(data / "train" / name)) for name in (*sources.generate_heads, *sources.ablations)
    }
    posegan = networks["posegan"]
    poses, speakers = posegan.settings.poses, posegan.speakers
    splits = {split: _recordings(sources, poses, split) for split in ("train", "val", "test")}
    classifier = train_classifier(CLASSIFIER, *(_labelled(splits[split], speakers) for split in ("train", "val")))
    test = [each for each in splits["test"] if each.clip.speaker in speakers]
    true = [each.pose / posegan.scale.numpy() for each in test]
    rows = {name: _row(network, test, true, classifier, seed) for name, network in networks.items()}
    return {
        "speakers": list(speakers),
        "table1": _table1(splits, data, speakers),
        "classifier": _plain(classifier_scores(classifier, _labelled(splits["test"], speakers))),
        "truth": {
            "jitter": jitter(true, poses.fps),
            "variety": clip_difference(true),
            "seams": seam_speed_ratio(true, WINDOW_FRAMES, SHARED_FRAMES),
        },
        "rows": rows,
        "noise": _noise_metrics(posegan, sources, test, true, classifier, seed),
        "strangers": _new_speaker_metrics(posegan, sources.new_speakers, classifier, seed),
    }


def _recordings(sources: PoseInputPaths, settings: PoseSettings, split: str) -> PoseRecordings:
    data = sources.data
    return pose_recordings(Corpus(sources.corpus), data / "fit", data / "embed", settings, split, take=0)


def _labelled(recordings: Sequence[PoseRecording], speakers: Sequence[str]) -> LabelledWindows:
    known = [each for each in recordings if each.clip.speaker in speakers and len(each) >= WINDOW_FRAMES]
    pieces = [sliding_windows(each.pose, WINDOW_FRAMES, HOP_FRAMES) for each in known]
    speaker_index = np.repeat([speakers.index(each.clip.speaker) for each in known], [len(each) for each in pieces])
    return LabelledWindows(np.concatenate(pieces), speaker_index)


def _table1(splits: dict[str, PoseRecordings], data: Path, speakers: Sequence[str]) -> dict[str, Any]:
    normaliser = Normaliser.of(data / "embed")
    std = np.maximum(normaliser.std, 1e-6)

    def standard(split: str) -> PoseWindows:
        found = pose_windows(splits[split], speakers, WINDOW_FRAMES, SVM_HOP)
        return PoseWindows((found.speech - normaliser.mean) / std, found.pose, found.speaker)

    found = acceptance_rates(standard("train"), standard("test"), speakers, SVM)
    return {"own": found.matched.tolist(), "random": found.random_poses.tolist()}


def _row(
    network: SpeechToPose,
    test: Sequence[PoseRecording],
    true: Sequence[Float[ndarray, "T 6"]],
    classifier: PoseClassifier,
    seed: int,
) -> dict[str, Any]:
    """Metrics of one model on the speech of the test split, in the style of each speaker."""
    generated = [_generate(network, each, each.speech, seed) for each in test]
    speaker_index = [network.speakers.index(each.clip.speaker) for each in test]
    return {
        **_reference_free_metrics(network, generated),
        **asdict(movement_ratios(generated, true)),
        **{f"l2_{name}": value for name, value in asdict(distances(generated, true)).items()},
        **_classifier_metrics(network, generated, speaker_index, classifier),
        "variety": clip_difference(generated),
        "parameters": _parameters(network),
        "generation_s": _cost(network, test[0].speech),
    }


def _generate(
    network: SpeechToPose, recording: PoseRecording, speech: Float[ndarray, "T C"], seed: int
) -> Float[ndarray, "T 6"]:
    """Sample poses in the speaker's own style, in standard deviations; each clip has its own seed."""
    own = int(np.random.default_rng([seed, *recording.clip.id.encode()]).integers(2**31))
    generated = network.sample(speech, [own], network.style_of(recording.clip.speaker))[0]
    return np.asarray(generated / network.scale.numpy())


def _reference_free_metrics(network: SpeechToPose, generated: Sequence[Float[ndarray, "T 6"]]) -> dict[str, float]:
    """Metrics without reference; `pace` is in standard deviations of poses per frame."""
    pace = float(np.mean([np.diff(each, axis=0).std() for each in generated]))
    window, shared = (network.head.window, SHARED_FRAMES) if network.head.window else (WINDOW_FRAMES, 0)
    return {
        "jitter": jitter(generated, network.settings.poses.fps),
        "seams": seam_speed_ratio(generated, window, shared),
        "pace": pace,
    }


def _classifier_metrics(
    network: SpeechToPose,
    generated: Sequence[Float[ndarray, "T 6"]],
    speaker_index: Sequence[int],
    classifier: PoseClassifier,
) -> dict[str, Any]:
    poses = [(each * network.scale.numpy()).astype(np.float32) for each in generated]
    pieces = [sliding_windows(each, WINDOW_FRAMES, HOP_FRAMES) for each in poses]
    whole = LabelledWindows(np.concatenate(pieces), np.repeat(speaker_index, [len(each) for each in pieces]))
    return _plain(classifier_scores(classifier, whole))


def _plain(scores: Any) -> dict[str, Any]:
    return {name: value.tolist() for name, value in asdict(scores).items()}


def _parameters(network: SpeechToPose) -> int:
    discriminator_parameters = (
        sum(each.numel() for each in network.discriminator.parameters()) if network.discriminator else 0
    )
    return sum(each.numel() for each in network.parameters()) - discriminator_parameters


def _cost(network: SpeechToPose, speech: Float[ndarray, "T C"]) -> float:
    """CPU seconds to generate ten minutes of motion."""
    frames = int(COST_MINUTES * 60 * network.settings.poses.fps)
    long = np.tile(speech, (frames // len(speech) + 1, 1))[:frames]
    start = time.process_time()
    for _ in network.stream(long, [0], network.style_of(network.speakers[0])):
        pass
    return time.process_time() - start


def _noise_metrics(
    network: SpeechToPose,
    sources: PoseInputPaths,
    test: Sequence[PoseRecording],
    true: Sequence[Float[ndarray, "T 6"]],
    classifier: PoseClassifier,
    seed: int,
) -> dict[str, Any]:
    """Metrics with white noise added to the sound, by signal-to-noise ratio of mean power in dB."""
    path = sources.data / "embed" / "embedding.json"
    settings = EmbedSettings.model_validate(read_json(path, "embedding")["settings"])
    encoder, corpus = make_encoder(settings), Corpus(sources.corpus)
    found = {}
    for ratio_db in NOISE_DB:
        generated = []
        for each in test:
            sound = corpus.speech(each.clip)
            rng = np.random.default_rng([seed, *each.clip.id.encode()])
            level = np.sqrt(np.mean(sound**2)) * 10 ** (-ratio_db / 20)
            features = encoder((sound + level * rng.standard_normal(len(sound))).astype(np.float32), each.clip.fps)
            speech = resample_linear(features, each.clip.fps, network.settings.poses.fps)[: len(each)]
            generated.append(_generate(network, each, speech, seed))
        speaker_index = [network.speakers.index(each.clip.speaker) for each in test]
        found[f"{ratio_db:g}"] = {
            **_reference_free_metrics(network, generated),
            **asdict(movement_ratios(generated, true)),
            **_classifier_metrics(network, generated, speaker_index, classifier),
        }
    return found


def _new_speaker_metrics(network: SpeechToPose, data: Path, classifier: PoseClassifier, seed: int) -> dict[str, Any]:
    """Metrics of style transfer to new people, and of the learnt styles under their languages."""
    corpus, embed, settings = Corpus(data / "synthesize"), data / "embed", network.settings.poses
    people: dict[str, list[PoseRecording]] = {}
    for clip in corpus.clips:
        if clip.take == 0:
            motion = corpus.truth(clip)
            raw = resample_cubic(to_poses(motion.head, motion.translation), motion.fps, settings.fps)
            pose = gaussian_smooth(raw, settings.filter_sigma_frames, settings.filter_radius_frames)
            speech = resample_linear(np.load(shard_path(embed / "speech", clip.sound, ".npy")), clip.fps, settings.fps)
            frames, centre = min(len(pose), len(speech)), pose.mean(0)
            recording = PoseRecording(clip, speech[:frames], (pose - centre)[:frames].astype(np.float32), centre)
            people.setdefault(clip.speaker, []).append(recording)
    return {
        "transfer": _transfer(network, list(people.values()), classifier, seed),
        "languages": _languages(network, [each for clips in people.values() for each in clips[:1]], classifier, seed),
    }


def _transfer(
    network: SpeechToPose, people: Sequence[Sequence[PoseRecording]], classifier: PoseClassifier, seed: int
) -> dict[str, Any]:
    """Style distance between a new person and motion generated for another of their clips, by style used."""
    scale, count = network.scale.numpy(), len(network.speakers)
    found: dict[str, list[float]] = {}

    def note(name: str, value: float) -> None:
        found.setdefault(name, []).append(value)

    for clips in people:
        reference, other = clips[0], clips[1]
        theirs = measure_style(other.pose / scale)

        def of(style: ndarray, other: PoseRecording = other, theirs: ndarray = theirs) -> float:
            return style_distance(measure_style(network.sample(other.speech, [seed], style)[0] / scale), theirs)

        apart = [of(style) for style in np.eye(count)]
        note("the best of the learnt styles", min(apart))
        note("any learnt style", float(np.mean(apart)))
        note("all styles alike", of(np.full(count, 1 / count)))
        for seconds in REFERENCE_S:
            shares = blend_styles(classifier, reference.pose[: round(seconds * network.settings.poses.fps)])
            note(f"nearest, of {seconds:g} s", apart[int(shares.argmax())])
            note(f"blend, of {seconds:g} s", of(shares))
        note("the person's own other clip", style_distance(measure_style(reference.pose / scale), theirs))
        new_speakers = [
            style_distance(measure_style(each[0].pose / scale), theirs) for each in people if each is not clips
        ]
        note("another new person", float(np.mean(new_speakers)))
    return {name: float(np.mean(values)) for name, values in found.items()}


def _languages(
    network: SpeechToPose, clips: Sequence[PoseRecording], classifier: PoseClassifier, seed: int
) -> dict[str, Any]:
    """By language: classifier confidence and amount of motion, to compare with the language of training."""
    scale = network.scale.numpy()
    found = {}
    for language in sorted({each.clip.language for each in clips}):
        spoken = [each for each in clips if each.clip.language == language]
        speaker_index = [number % len(network.speakers) for number in range(len(spoken))]
        styles = np.eye(len(network.speakers))[speaker_index]
        generated = [
            network.sample(each.speech, [seed], style)[0] / scale for each, style in zip(spoken, styles, strict=True)
        ]
        classified = _classifier_metrics(network, generated, speaker_index, classifier)
        found[language] = {**_reference_free_metrics(network, generated), **classified}
    return found
