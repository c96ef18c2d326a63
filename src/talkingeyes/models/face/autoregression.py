"""Deterministic autoregressive regression of the face, after FaceFormer (Fan et al. 2022).

A causal transformer over past frames of the face, with attention to the speech around the current frame (FaceFormer's
alignment bias, widened), predicts the next frame. FaceFormer is trained in free running. Here a fraction of the history
is replaced by predictions of a first pass over all frames (Mihaylova & Martins 2019), which costs two passes instead of
one per frame. The style multiplies the speech features, as in all compared models.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.layers.normaliser import MotionNormaliser
from talkingeyes.models.layers.transformer import (
    CausalTransformer,
    CrossAttentionWindow,
    TransformerSettings,
    shift_right,
)


class AutoregressionSettings(ComponentSettings):
    """Settings of a decoder that sees its own past."""

    transformer: TransformerSettings
    # Numbers of speech frames before and after its own that cross-attention uses.
    speech_lookback: Annotated[int, Field(ge=0)]
    speech_lookahead: Annotated[int, Field(ge=0)]
    # Fraction of past frames that are replaced by predictions in training.
    own_history_fraction: Annotated[float, Field(ge=0, le=1)]


class RegressionFaceSettings(AutoregressionSettings):
    """Settings of the regression of the face."""

    kind: Literal["autoregression"]


class RegressionFace(nn.Module):
    """Predicts the next frame of a face from the previous frames and the speech."""

    settings_class = RegressionFaceSettings

    def __init__(
        self, settings: RegressionFaceSettings, speech: int, face_dim: int, tokenizer: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        self.settings, self.normal = settings, MotionNormaliser(face_dim)
        self.decoder = AutoregressiveDecoder(settings, speech, face_dim, face_dim)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set mean and scale of faces."""
        self.normal.set(mean, scale)

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Mean squared error of expression and jaw, and for comparison the loss of copying the last frame."""
        true = self.normal(face)
        first = shift_right(true)
        with torch.no_grad():
            own = shift_right(self.decoder(speech, first))
        predicted = self.decoder(speech, mix_history(first, own, self.settings.own_history_fraction))
        copied = reconstruction(first, true, squared=True)["expression"]
        return {**reconstruction(predicted, true, squared=True), "copy_last_frame": copied.detach()}

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Generate frame by frame. Deterministic: all seeds give the same face."""
        frames = []
        previous = torch.zeros_like(self.normal.mean).expand(1, -1)
        decoding = self.decoder.start(speech)
        for position in range(speech.shape[1]):
            previous = decoding.decode_step(position, previous)
            frames.append(previous)
        return self.normal.denormalise(torch.stack(frames, dim=1)).expand(len(seeds), -1, -1)


class AutoregressiveDecoder(nn.Module):
    """A causal transformer from `input_dim` to `output_dim` numbers per frame, with speech as memory."""

    def __init__(self, settings: AutoregressionSettings, speech: int, input_dim: int, output_dim: int) -> None:
        super().__init__()
        width = settings.transformer.width
        self.embed = nn.Linear(input_dim, width)
        self.memory = nn.Linear(speech, width)
        window = CrossAttentionWindow(settings.speech_lookback, settings.speech_lookahead)
        self.transformer = CausalTransformer(settings.transformer, window)
        self.out = nn.Linear(width, output_dim)

    def forward(self, speech: Float[Tensor, "B T S"], history: Float[Tensor, "B T H"]) -> Float[Tensor, "B T O"]:
        """Outputs of all frames in parallel; `history` holds the frame before each."""
        memory = self.memory(speech)
        out: Tensor = self.out(self.transformer(self.embed(history) + memory, memory))
        return out

    def start(self, speech: Float[Tensor, "B T S"]) -> DecodingState:
        """Start decoding frame by frame."""
        return DecodingState(self, self.memory(speech))


class DecodingState:
    """State of decoding: the cache of the transformer and the memory."""

    def __init__(self, decoder: AutoregressiveDecoder, memory: Float[Tensor, "B T W"]) -> None:
        self.decoder, self.memory = decoder, memory
        self.cache = decoder.transformer.start(memory)

    def decode_step(self, position: int, previous: Float[Tensor, "B H"]) -> Float[Tensor, "B O"]:
        """Output of a frame, given the frame before it."""
        x = self.decoder.embed(previous)[:, None] + self.memory[:, position : position + 1]
        out: Tensor = self.decoder.out(self.decoder.transformer.step(x, self.cache))[:, 0]
        return out


def mix_history(true: Float[Tensor, "B T H"], own: Float[Tensor, "B T H"], fraction: float) -> Float[Tensor, "B T H"]:
    """Replace a fraction of the frames of a history by predictions."""
    replaced = torch.rand(true.shape[:2], device=true.device) < fraction
    return torch.where(replaced[..., None], own, true)
