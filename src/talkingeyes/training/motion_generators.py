"""Trained models as generators of head and gaze behind one interface, for networks and baselines.

A folder of the train stage contains everything that generation needs (codebook, statistics of the embedding).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings, validate_section
from talkingeyes.corpus.poses import head_rotations, resample_cubic, resample_linear
from talkingeyes.corpus.recordings import Normaliser
from talkingeyes.corpus.samples import Samples
from talkingeyes.models.baselines import BaselineSettings, MotionBank, sample_bank
from talkingeyes.models.condition.conditioner import NO_CONDITIONING, ConditioningInputs, InputName
from talkingeyes.models.gaze.vqvae import GazeVQVAE, GazeVQVAESettings
from talkingeyes.models.replay import ReplayBank, ReplaySettings, sample_replay
from talkingeyes.models.speech_to_motion import MotionBatch, SpeechInput, SpeechToMotion
from talkingeyes.models.speech_to_pose import SpeechToPose
from talkingeyes.training.baseline_checkpoint import load_baseline, load_replay
from talkingeyes.training.checkpoint import Checkpoint, build_network, load, save
from talkingeyes.training.motion_task import MotionTaskSettings
from talkingeyes.training.pose_task import PoseTaskSettings


@dataclass(frozen=True)
class Speech:
    """A whole speech to generate motions for, a seed per motion, with the model's further inputs."""

    embedding: Float[ndarray, "T C"]
    seeds: list[int]
    fps: float
    conditioning: ConditioningInputs = NO_CONDITIONING


class TrainedGenerator:
    """From speech embedding to S motions of head and gaze. A seed gives the same motion in any batch.

    A subclass implements `sample`, or `generate_batch` if it samples several speeches together.
    """

    def generate(
        self,
        embedding: Float[ndarray, "T C"],
        seeds: list[int],
        fps: float,
        conditioning: ConditioningInputs = NO_CONDITIONING,
    ) -> Samples:
        """Motions of one speech. `conditioning` holds the model's further inputs (`required_inputs`) for all of it."""
        return self.generate_batch([Speech(embedding, seeds, fps, conditioning)])[0]

    def generate_batch(self, speeches: Sequence[Speech]) -> list[Samples]:
        """Motions of each of several speeches."""
        return [self.sample(each) for each in speeches]

    def sample(self, speech: Speech) -> Samples:
        """Motions of one speech."""
        raise NotImplementedError


@dataclass(frozen=True)
class NetworkGenerator(TrainedGenerator):
    """A trained joint model."""

    network: SpeechToMotion

    def generate_batch(self, speeches: Sequence[Speech]) -> list[Samples]:
        """Motions of each of several speeches, sampled in one batch."""
        inputs = [
            SpeechInput(torch.from_numpy(np.array(each.embedding, np.float32)), each.seeds, each.conditioning)
            for each in speeches
        ]
        return [
            Samples(speech.fps, out.head.numpy().astype(np.float64), out.gaze.numpy().astype(np.float64))
            for speech, out in zip(speeches, self.network.generate_batch(inputs), strict=True)
        ]

    def generate_gaze(
        self,
        embedding: Float[ndarray, "T C"],
        head: Float[ndarray, "S T 3"],
        seeds: list[int],
        conditioning: ConditioningInputs,
    ) -> Float[ndarray, "S T 2 3"]:
        """Sample gaze for the heads of another model."""
        speech, heads = (torch.from_numpy(np.array(each, np.float32)) for each in (embedding, head))
        return self.network.generate_gaze(speech, heads, seeds, conditioning).numpy()

    def log_likelihood(
        self,
        embedding: Float[ndarray, "T C"],
        head: Float[ndarray, "T 3"],
        gaze: Float[ndarray, "T 2 3"],
        conditioning: ConditioningInputs = NO_CONDITIONING,
    ) -> dict[str, float]:
        """Terms of the log-likelihood of a motion in nats (`SpeechToMotion.log_likelihood`); empty if it has none."""
        one = [torch.from_numpy(np.array(each, np.float32))[None] for each in (embedding, head, gaze)]
        found = self.network.log_likelihood(MotionBatch(one[0], one[1], one[2], conditioning))
        return {name: float(value) for name, value in found.items()}


@dataclass(frozen=True)
class BaselineGenerator(TrainedGenerator):
    """A baseline over the bank of training motions."""

    settings: BaselineSettings
    bank: MotionBank

    def sample(self, speech: Speech) -> Samples:
        """Sample from the bank."""
        return _motion_samples(speech, sample_bank(self.settings, self.bank, speech.embedding, speech.seeds))


@dataclass(frozen=True)
class ReplayGenerator(TrainedGenerator):
    """A lookup in the bank of training clips."""

    settings: ReplaySettings
    bank: ReplayBank

    def sample(self, speech: Speech) -> Samples:
        """Look up and replay."""
        return _motion_samples(speech, sample_replay(self.settings, self.bank, speech.embedding, speech.seeds))


def _motion_samples(speech: Speech, motion: Float[ndarray, "B T 9"]) -> Samples:
    motion = motion.astype(np.float64)
    return Samples(speech.fps, motion[..., :3], motion[..., 3:].reshape(*motion.shape[:2], 2, 3))


@dataclass(frozen=True)
class PoseModelGenerator(TrainedGenerator):
    """From speech embedding to S head motions around the mean pose of the train split; the eyes look straight ahead."""

    network: SpeechToPose

    def sample(self, speech: Speech) -> Samples:
        """Sample heads of one speaker, at the frame rate of the embedding."""
        own, style = self.network.settings.poses.fps, self.network.conditioning_style(speech.conditioning)
        embedding = resample_linear(speech.embedding, speech.fps, own).astype(np.float32)
        pose = self.network.sample(embedding, speech.seeds, style) + self.network.mean_pose.numpy()
        frames = len(speech.embedding)
        rows = [_pad_or_trim(resample_cubic(each.astype(np.float64), own, speech.fps), frames) for each in pose]
        head = head_rotations(np.stack(rows))
        return Samples(speech.fps, head, np.zeros((*head.shape[:2], 2, 3)))


def _pad_or_trim(rows: Float[ndarray, "T C"], frames: int) -> Float[ndarray, "U C"]:
    """The first frames; the last row is repeated for frames lost in resampling."""
    return np.pad(rows[:frames], ((0, max(frames - len(rows), 0)), (0, 0)), mode="edge")


class HeadThenGazeSettings(Settings):
    """The head of one trained model and the gaze decoder of another."""

    kind: Literal["head_then_gaze"]
    parts: tuple[Literal["head", "gaze"], ...]
    tokenizer: None
    # The model that generates the head (any), and the one with the gaze decoder (`kind: speech_to_motion`).
    source_models: tuple[str, str]


@dataclass(frozen=True)
class HeadThenGaze(TrainedGenerator):
    """The head of one model, and gaze for this head by another."""

    head: TrainedGenerator
    gaze: NetworkGenerator

    def sample(self, speech: Speech) -> Samples:
        """Sample the head first, then gaze for the same speech and head. Both models get the same conditioning."""
        head = self.head.generate_batch([speech])[0].head
        gaze = self.gaze.generate_gaze(speech.embedding, head, speech.seeds, speech.conditioning)
        return Samples(speech.fps, head, gaze.astype(np.float64))


def save_head_then_gaze(folder: Path, settings: HeadThenGazeSettings, head: Checkpoint, gaze: Checkpoint) -> None:
    """Write both models as one checkpoint.

    Raises InputError if the second has no gaze decoder, or if both are conditioned on the speaker and have others.
    """
    kind = gaze.config["model"]["kind"]
    if kind != "speech_to_motion":
        raise InputError(
            f"source_models: the second should be a model of kind speech_to_motion, got one of kind {kind}"
        )
    known = [training_speakers(_generator(each)) for each in (head, gaze)]
    if all(known) and known[0] != known[1]:
        first, second = (", ".join(each) for each in known)
        raise InputError(f"source_models: should have the same training speakers, got {first} and {second}")
    both = {"head": head, "gaze": gaze}
    tensors = {f"{part}.{name}": tensor for part, each in both.items() for name, tensor in each.tensors.items()}
    config = {"model": settings.model_dump(mode="json"), **{part: each.config for part, each in both.items()}}
    save(folder, tensors, config)


def required_inputs(generator: TrainedGenerator) -> frozenset[InputName]:
    """Inputs of a trained model besides the embedding."""
    if isinstance(generator, NetworkGenerator | PoseModelGenerator):
        return generator.network.required_inputs
    if isinstance(generator, HeadThenGaze):
        return required_inputs(generator.gaze) | required_inputs(generator.head)
    return frozenset()


def training_speakers(generator: TrainedGenerator) -> tuple[str, ...]:
    """The training speakers of a model conditioned on the speaker, in index order."""
    if "speaker" not in required_inputs(generator):
        return ()
    if isinstance(generator, HeadThenGaze):
        return training_speakers(generator.gaze) or training_speakers(generator.head)
    return generator.network.speakers if isinstance(generator, NetworkGenerator | PoseModelGenerator) else ()


def network_config(
    settings: MotionTaskSettings,
    channels: Sequence[str],
    codebook: GazeVQVAE | None,
    network: SpeechToMotion | None = None,
) -> dict[str, Any]:
    """The configuration that rebuilds a network, with its speakers and the architecture of a waveform encoder."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(channels),
        "codebook": codebook.settings.model_dump(mode="json") if codebook else None,
        "speakers": list(network.speakers) if network else [],
        "architecture": network.waveform_encoder.architecture() if network and network.waveform_encoder else None,
    }


def pose_config(settings: PoseTaskSettings, normaliser: Normaliser, network: SpeechToPose) -> dict[str, Any]:
    """The configuration that rebuilds a model of the head alone."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(normaliser.channels),
        "speakers": list(network.speakers),
    }


def load_generator(folder: Path) -> TrainedGenerator:
    """Load the model of a folder of the train stage. Raises InputError if it is missing or damaged."""
    checkpoint = load(folder)
    try:
        return _generator(checkpoint)
    except (KeyError, RuntimeError, ValueError) as error:
        raise InputError(f"{folder}: not a model of this version ({error}); `make repro` trains one") from None


def _generator(checkpoint: Checkpoint) -> TrainedGenerator:
    kind = checkpoint.config["model"]["kind"]
    if kind == "speech_to_motion":
        return NetworkGenerator(_network(checkpoint))
    if kind == "speech_to_pose":
        return PoseModelGenerator(pose_network(checkpoint))
    if kind == "head_then_gaze":
        gaze = NetworkGenerator(_network(_part(checkpoint, "gaze")))
        return HeadThenGaze(_generator(_part(checkpoint, "head")), gaze)
    if kind in ("aligned_replay", "pieced_replay"):
        return ReplayGenerator(*load_replay(checkpoint))
    return BaselineGenerator(*load_baseline(checkpoint))


def _part(checkpoint: Checkpoint, part: str) -> Checkpoint:
    """One of the two models of a combined checkpoint."""
    tensors = {name: tensor for name, tensor in checkpoint.tensors.items() if name.startswith(f"{part}.")}
    return Checkpoint(checkpoint.config[part], {name.removeprefix(f"{part}."): each for name, each in tensors.items()})


def _network(checkpoint: Checkpoint) -> SpeechToMotion:
    config = checkpoint.config
    settings = validate_section("model", MotionTaskSettings, config["model"])

    def build() -> SpeechToMotion:
        codebook = None
        if config["codebook"]:
            codebook = GazeVQVAE(validate_section("codebook", GazeVQVAESettings, config["codebook"])).freeze()
        return SpeechToMotion(settings, config["channels"], codebook, config["speakers"], config["architecture"])

    return build_network(build, checkpoint.tensors)


def pose_network(checkpoint: Checkpoint) -> SpeechToPose:
    """Load the network of a checkpoint of a model of the head alone."""
    config = checkpoint.config
    settings = validate_section("model", PoseTaskSettings, config["model"])
    return build_network(lambda: SpeechToPose(settings, config["channels"], config["speakers"]), checkpoint.tensors)
