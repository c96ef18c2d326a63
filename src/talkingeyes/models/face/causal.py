"""A face for streams: causal convolutions from speech features to the face; deterministic.

All lookahead is that of the speech projection. Not in the papers: their models of the face look at the whole clip.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.layers.normaliser import MotionNormaliser


class CausalFaceSettings(ComponentSettings):
    """Settings of the convolutions (`models/layers/convolution.py`)."""

    kind: Literal["causal"]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]


class CausalFace(nn.Module):
    """The mean face given the speech so far and its lookahead."""

    settings_class = CausalFaceSettings

    def __init__(
        self, settings: CausalFaceSettings, speech: int, face_dim: int, tokenizer: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        self.settings, self.normal = settings, MotionNormaliser(face_dim)
        self.stack = ConvolutionStack(speech, speech, settings.layers, settings.dropout, lookahead=0)
        self.out = nn.Linear(speech, face_dim)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set mean and scale of faces."""
        self.normal.set(mean, scale)

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """L1 of expression and jaw, and of all changes from frame to frame, in normalised units."""
        predicted, true = self.out(self.stack(speech)), self.normal(face)
        velocity = F.l1_loss(predicted.diff(dim=1).float(), true.diff(dim=1))
        return {**reconstruction(predicted, true), "velocity": velocity}

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """The same face for all seeds."""
        return self.decode(self.stack(speech)).expand(len(seeds), -1, -1)

    def decode(self, hidden: Float[Tensor, "B T S"]) -> Float[Tensor, "B T F"]:
        """Faces from the last hidden features."""
        return self.normal.denormalise(self.out(hidden))
