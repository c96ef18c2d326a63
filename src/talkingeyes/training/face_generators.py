"""Trained face models behind one interface, for networks and baselines.

A folder of the train stage contains everything that generation needs (autoencoder, speakers, shapes of the head model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.models.baselines import BaselineSettings, MotionBank, sample_bank
from talkingeyes.models.face.basis import JAW_DIM, FaceBasis
from talkingeyes.models.face.emotion_mean import EmotionMeans
from talkingeyes.models.face.style import StyleKey, StyleVocabulary, blend_over_time
from talkingeyes.models.speech_to_face import SpeechToFace
from talkingeyes.training.baseline_checkpoint import load_baseline, load_emotion_means
from talkingeyes.training.checkpoint import Checkpoint, build_network, load
from talkingeyes.training.face_task import FaceData, FaceTaskSettings
from talkingeyes.training.face_tokenizer import FaceTokenizer, build_face_tokenizer


@runtime_checkable
class TrainedFaceGenerator(Protocol):
    """From speech embedding and style keys to S faces. A seed gives the same face in any batch."""

    @property
    def basis(self) -> FaceBasis: ...

    @property
    def vocabulary(self) -> StyleVocabulary: ...

    def generate(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seeds: list[int], fps: float
    ) -> FaceSamples: ...


@dataclass(frozen=True)
class NetworkFaceGenerator:
    """A trained network."""

    network: SpeechToFace
    basis: FaceBasis
    vocabulary: StyleVocabulary

    def generate(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seeds: list[int], fps: float
    ) -> FaceSamples:
        """Sample the network. Raises InputError for an unknown speaker."""
        style_course = torch.from_numpy(self.vocabulary.per_frame(style, len(embedding), fps))
        faces = self.network.generate(torch.from_numpy(np.array(embedding, np.float32)), style_course, seeds)
        return _samples(faces.numpy(), fps, self.basis)


@dataclass(frozen=True)
class BaselineFaceGenerator:
    """A baseline over the bank of training faces; it ignores the style."""

    settings: BaselineSettings
    bank: MotionBank
    basis: FaceBasis
    vocabulary: StyleVocabulary

    def generate(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seeds: list[int], fps: float
    ) -> FaceSamples:
        """Sample from the bank. Raises InputError for an unknown speaker."""
        for key in style:
            self.vocabulary.style_vector(key.style)
        return _samples(sample_bank(self.settings, self.bank, embedding, seeds), fps, self.basis)


@dataclass(frozen=True)
class EmotionMeanGenerator:
    """The mean face of the emotion, whatever is said."""

    bank: EmotionMeans
    basis: FaceBasis
    vocabulary: StyleVocabulary

    def generate(
        self, embedding: Float[ndarray, "T C"], style: Sequence[StyleKey], seeds: list[int], fps: float
    ) -> FaceSamples:
        """The same face for all seeds."""
        faces = blend_over_time(style, np.arange(len(embedding)) / fps, self.bank.face)
        return _samples(np.repeat(faces[None], len(seeds), axis=0), fps, self.basis)


def face_config(settings: FaceTaskSettings, data: FaceData, tokenizer: FaceTokenizer | None) -> dict[str, Any]:
    """The configuration that rebuilds a network."""
    return {
        "model": settings.model_dump(mode="json"),
        "channels": list(data.normaliser.channels),
        **face_space(data),
        "tokenizer": tokenizer.to_dict() if tokenizer else None,
    }


def face_space(data: FaceData) -> dict[str, Any]:
    """The part of a configuration that networks and baselines share: head model and speakers."""
    return {"basis": data.basis.to_dict(), "speakers": list(data.vocabulary.speakers)}


def load_face_generator(folder: Path, head: FaceBasis | None = None) -> TrainedFaceGenerator:
    """Load the face model of a folder of the train stage.

    Raises InputError (one line) if it is missing, damaged, not a face model, or of another head model than `head`.
    """
    checkpoint = load(folder)
    try:
        generator = _generator(checkpoint)
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise InputError(f"{folder}: not a model of the face ({error}); `make report` trains probtalk3d") from None
    if head is not None:
        generator.basis.require_match(head, str(folder), "train one on faces of that head")
    return generator


def _generator(checkpoint: Checkpoint) -> TrainedFaceGenerator:
    config = checkpoint.config
    basis, vocabulary = FaceBasis.of(config["basis"]), StyleVocabulary(tuple(config["speakers"]))
    if config["model"]["kind"] == "emotion_mean":
        return EmotionMeanGenerator(load_emotion_means(checkpoint), basis, vocabulary)
    if config["model"]["kind"] != "speech_to_face":
        return BaselineFaceGenerator(*load_baseline(checkpoint), basis, vocabulary)
    settings = validate_section("model", FaceTaskSettings, config["model"])

    def build() -> SpeechToFace:
        tokenizer = build_face_tokenizer(config["tokenizer"]).network if config["tokenizer"] else None
        return SpeechToFace(settings, config["channels"], vocabulary, basis.numbers, tokenizer)

    return NetworkFaceGenerator(build_network(build, checkpoint.tensors), basis, vocabulary)


def _samples(faces: Float[ndarray, "S T F"], fps: float, basis: FaceBasis) -> FaceSamples:
    faces = faces.astype(np.float64)
    return FaceSamples(fps, faces[..., -JAW_DIM:], faces[..., :-JAW_DIM], basis.expression_names, basis.head_model)
