"""Speech to head poses of six dimensions: speech features, a speaker's style and a pose generator.

`kind: speech_to_pose` in conf/model/: PoseGAN (Zhang et al., section 4.1), its baselines, VAE and VQ-VAE are instances
of this model with different generators. A style is a mixture of the training speakers, given by K weights.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.corpus.poses import PoseSettings
from talkingeyes.models.condition.conditioner import ConditioningInputs, InputName
from talkingeyes.models.head.discriminator import Discriminator, DiscriminatorContext, DiscriminatorSettings
from talkingeyes.models.head.pose_generator import (
    POSE_GENERATORS,
    PoseComponentSettings,
    PoseGenerator,
    PoseInputs,
    PosePrediction,
)
from talkingeyes.models.speech_projection import SpeechProjection, SpeechProjectionSettings

# Number of stored poses per speaker at which a first window may start.
START_POSES = 64
# Frames that a window repeats of the window before: the last one, its initial pose.
SHARED_FRAMES = 1


class SpeechToPoseSettings(Settings):
    """Components of the model. Weights are keyed by loss term."""

    kind: Literal["speech_to_pose"]
    parts: tuple[Literal["head"], ...]
    tokenizer: None
    poses: PoseSettings
    speech: SpeechProjectionSettings
    head: PoseComponentSettings
    # The discriminator; null: none.
    discriminator: DiscriminatorSettings | None
    weights: dict[str, Annotated[float, Field(ge=0)]]


@dataclass(frozen=True)
class PoseBatch:
    """Speech embedding, centred poses (radians, metres) and styles of B windows of T frames."""

    speech: Float[Tensor, "B T C"]
    pose: Float[Tensor, "B T 6"]
    style: Float[Tensor, "B K"]


class SpeechToPose(nn.Module):
    """The model. `scale` holds the standard deviation of each dimension, `start_poses` poses of the speakers."""

    required_inputs: frozenset[InputName] = frozenset({"speaker"})
    scale: Tensor
    mean_pose: Tensor
    start_poses: Tensor

    def __init__(self, settings: SpeechToPoseSettings, channels: Sequence[str], speakers: Sequence[str]) -> None:
        super().__init__()
        self.settings, self.speakers = settings, tuple(speakers)
        self.speech = SpeechProjection(settings.speech, channels)
        self.style_embedding = nn.Linear(len(speakers), settings.speech.width, bias=False)
        embedding = len(self.speech.channel_indices)
        self.head: PoseGenerator = POSE_GENERATORS.build(settings.head, settings.speech.width, embedding)
        self.discriminator = (
            Discriminator(settings.discriminator, len(speakers), embedding) if settings.discriminator else None
        )
        self.register_buffer("scale", torch.ones(6))
        self.register_buffer("mean_pose", torch.zeros(6))
        self.register_buffer("start_poses", torch.zeros(len(speakers), START_POSES, 6))

    def encode_speech(self, speech: Float[Tensor, "B T C"], style: Float[Tensor, "B K"]) -> PoseInputs:
        """Learned features with the style added, the style alone, and the standardised embedding."""
        vector = self.style_embedding(style)
        return PoseInputs(self.speech(speech) + vector[:, None], vector, self.speech.standardise(speech))

    def predict(self, batch: PoseBatch) -> PosePrediction:
        """Poses (in standard deviations), all loss terms and their weighted sum, `total`."""
        true = batch.pose / self.scale
        predicted = self.head.predict(self.encode_speech(batch.speech, batch.style), true)
        loss_terms = dict(predicted.loss_terms)
        if self.discriminator is not None:
            loss_terms["adversarial"] = self.discriminator.generator_loss(predicted.pose, self._context(batch))
        total = sum(weight * loss_terms[name] for name, weight in self.settings.weights.items())
        return PosePrediction(predicted.pose, {"total": total, **loss_terms})  # type: ignore[dict-item]

    def discriminator_terms(self, batch: PoseBatch, generated: Float[Tensor, "B T 6"]) -> dict[str, Tensor]:
        """Loss terms of the discriminator for generated poses (in standard deviations)."""
        assert self.discriminator is not None
        return self.discriminator.loss_terms(batch.pose / self.scale, generated.detach(), self._context(batch))

    def stream(
        self, speech: Float[ndarray, "T C"], seeds: Sequence[int], style: Float[ndarray, " K"]
    ) -> Iterator[Float[ndarray, "S U 6"]]:
        """Centred poses, window by window: each starts at the last pose of the one before. Memory is constant."""
        generators = [torch.Generator().manual_seed(int(seed)) for seed in seeds]
        styles = torch.from_numpy(np.asarray(style, np.float32)).to(self.scale.device).expand(len(generators), -1)
        pose = torch.stack([self._start(shares, each) for shares, each in zip(styles, generators, strict=True)])
        length = self.head.window or max(len(speech), 2)
        for first in range(0, max(len(speech) - SHARED_FRAMES, 1), length - SHARED_FRAMES):
            generated = self._window(speech[first : first + length], styles, pose, generators)
            pose = generated[:, -1]
            yield (generated[:, SHARED_FRAMES if first else 0 :] * self.scale).cpu().numpy()

    def sample(
        self, speech: Float[ndarray, "T C"], seeds: Sequence[int], style: Float[ndarray, " K"]
    ) -> Float[ndarray, "S T 6"]:
        """Centred poses at the frame rate of poses, one row per seed."""
        return np.concatenate(list(self.stream(speech, seeds, style)), axis=1)

    def style_of(self, speaker: str) -> Float[ndarray, " K"]:
        """The style of a training speaker."""
        return np.asarray(np.eye(len(self.speakers), dtype=np.float32)[self.speakers.index(speaker)])

    def conditioning_style(self, conditioning: ConditioningInputs) -> Float[ndarray, " K"]:
        """The style of the speaker of one window; without a speaker, all styles in equal parts."""
        if conditioning.speaker is None or conditioning.speaker.item() < 0:
            return np.full(len(self.speakers), 1 / len(self.speakers), np.float32)
        return self.style_of(self.speakers[int(conditioning.speaker)])

    @torch.no_grad()
    def _window(
        self,
        speech: Float[ndarray, "T C"],
        styles: Float[Tensor, "S K"],
        start: Float[Tensor, "S 6"],
        generators: list[torch.Generator],
    ) -> Float[Tensor, "S T 6"]:
        part = torch.from_numpy(np.array(speech, np.float32)).to(styles.device).expand(len(generators), -1, -1)
        return self.head.sample(self.encode_speech(part, styles), start, generators)

    def _context(self, batch: PoseBatch) -> DiscriminatorContext:
        return DiscriminatorContext(batch.style, self.speech.standardise(batch.speech))

    def _start(self, style: Float[Tensor, " K"], generators: torch.Generator) -> Float[Tensor, " 6"]:
        """A random stored pose of the speaker with the largest weight; the paper starts at rest."""
        return self.start_poses[style.argmax(), torch.randint(START_POSES, (1,), generator=generators)[0]]
