"""Speech to face: speech features, multiplied by the style, then a face generator (ProbTalk3D section 3.3.2).

`probtalk3d`, its variants and all compared models are instances of this model with different generators (conf/model/).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.models.face.autoencoder import FaceAutoencoder
from talkingeyes.models.face.generator import FACE_GENERATORS, FaceComponentSettings, FaceGenerator
from talkingeyes.models.face.style import StyleInput, StyleVocabulary
from talkingeyes.models.speech_projection import (
    CausalSpeechProjectionSettings,
    SpeechProjection,
    SpeechProjectionSettings,
)

# SD of the initial weights of emotion and intensity. PyTorch's for a one-hot vector of 200 speakers is 0.04, so that
# emotions differ by a tenth after 500 steps and are not seen (docs/log/2026-11-26-face-emotion.md).
STYLE_SD = 0.5


class SpeechToFaceSettings(Settings):
    """Components of the model. Weights are keyed by loss term (eq. 5)."""

    kind: Literal["speech_to_face"]
    parts: tuple[Literal["face"], ...]
    # The pretrained motion autoencoder that the generator needs; null: none.
    tokenizer: str | None
    speech: CausalSpeechProjectionSettings | SpeechProjectionSettings
    # Components of the style that the model is conditioned on; none: the paper's ablation.
    style: tuple[StyleInput, ...]
    # Fraction of training windows whose speaker is replaced by the mean of all, so that unseen speakers have a style.
    speaker_dropout: Annotated[float, Field(ge=0, lt=1)]
    face: FaceComponentSettings
    weights: dict[str, Annotated[float, Field(ge=0)]]
    # Temperature of sampling; of the VAE: factor on the noise (docs/log/2026-11-28-face-temperature-rule.md).
    temperature: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class FaceBatch:
    """Speech embedding, style vectors (one for all frames, or one per frame) and true faces of B windows of T
    frames."""

    speech: Float[Tensor, "B T C"]
    style: Float[Tensor, "B U D"]
    face: Float[Tensor, "B T F"]

    def to(self, device: torch.device) -> FaceBatch:
        """A copy on a device."""
        return FaceBatch(self.speech.to(device), self.style.to(device), self.face.to(device))


class SpeechToFace(nn.Module):
    """The whole model. Faces are limited to `min_face` .. `max_face`."""

    min_face: Tensor
    max_face: Tensor
    style_columns: Tensor

    def __init__(
        self,
        settings: SpeechToFaceSettings,
        channels: Sequence[str],
        vocabulary: StyleVocabulary,
        face_dim: int,
        tokenizer: FaceAutoencoder | None,
    ) -> None:
        super().__init__()
        self.settings, self.vocabulary, self.speakers = settings, vocabulary, len(vocabulary.speakers)
        self.speech = SpeechProjection(settings.speech, channels)
        columns = vocabulary.columns(settings.style)
        self.register_buffer("style_columns", torch.tensor(columns, dtype=torch.long))
        self.style = nn.Linear(len(columns), settings.speech.width) if columns else None
        if self.style is not None:
            nn.init.ones_(self.style.bias)  # the initial style factor is near 1
            shown = [index for index, column in enumerate(columns) if column >= self.speakers]
            with torch.no_grad():
                self.style.weight[:, shown] = STYLE_SD * torch.randn(settings.speech.width, len(shown))
        self.face: FaceGenerator = FACE_GENERATORS.build(settings.face, settings.speech.width, face_dim, tokenizer)
        self.register_buffer("min_face", torch.full((face_dim,), -torch.inf))
        self.register_buffer("max_face", torch.full((face_dim,), torch.inf))

    def set_range(self, min_face: Float[Tensor, " F"], max_face: Float[Tensor, " F"]) -> None:
        """Set the range of each dimension in the train split."""
        self.min_face.copy_(min_face)
        self.max_face.copy_(max_face)

    def loss_terms(self, batch: FaceBatch) -> dict[str, Tensor]:
        """All loss terms and their weighted sum, `total`. Terms without a weight are only reported."""
        batch = batch.to(self.min_face.device)
        loss_terms = self.face.loss_terms(
            self._stylised_speech(batch.speech, self._drop_speakers(batch.style)), batch.face
        )
        total = sum(weight * loss_terms[name] for name, weight in self.settings.weights.items())
        return {"total": total, **loss_terms}  # type: ignore[dict-item]

    @torch.no_grad()
    def generate(
        self,
        embedding: Float[Tensor, "T C"],
        style: Float[Tensor, "U D"],
        seeds: list[int],
        temperature: float | None = None,
    ) -> Float[Tensor, "B T F"]:
        """Faces of one speech with a style (a vector for all frames, or one per frame), one row per seed. `temperature`
        None: that of the settings."""
        device = self.min_face.device
        fused = self._stylised_speech(embedding[None].to(device), style[None].to(device))
        faces = self.face.sample(fused, seeds, self.settings.temperature if temperature is None else temperature)
        return self.limit(faces)

    def limit(self, faces: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Faces within the range of the train split."""
        return faces.clamp(self.min_face, self.max_face)

    def _stylised_speech(
        self, embedding: Float[Tensor, "B T C"], style: Float[Tensor, "B U D"]
    ) -> Float[Tensor, "B T S"]:
        return self.stylise(self.speech(embedding), style)

    def stylise(self, features: Float[Tensor, "B T S"], style: Float[Tensor, "B U D"]) -> Float[Tensor, "B T S"]:
        """Speech features multiplied by the style."""
        return features if self.style is None else features * self.style(style[..., self.style_columns])

    def _drop_speakers(self, style: Float[Tensor, "B U D"]) -> Float[Tensor, "B U D"]:
        strange = torch.rand(len(style), device=style.device) < self.settings.speaker_dropout
        speaker = torch.where(strange[:, None, None], 1 / self.speakers, style[..., : self.speakers])
        return torch.cat([speaker, style[..., self.speakers :]], dim=-1)
