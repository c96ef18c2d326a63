"""The trainable part of the speech encoder: standardises an embedding and projects it (A_1:T of the paper).

The packaged or loaded encoder is frozen, and its output is cached by the `embed` stage. This part is trained with each
model, as the paper trains a part of its encoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.convolution import ConvolutionStack


class SpeechProjectionSettings(Settings):
    """Settings of the projection."""

    # Input channels of the embedding (`logmel`: all of logmel_0, ...); null: all; empty: no speech input, constant
    # features.
    channels: tuple[str, ...] | None
    width: Annotated[int, Field(gt=0)]
    # Convolutions of kernel 5 with dilation 1, 2, 4, ...: 3 layers reach 14 frames to each side.
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Fraction of the embedding's channels that are hidden from a whole window in training.
    channel_dropout: Annotated[float, Field(ge=0, lt=1)]


class CausalSpeechProjectionSettings(SpeechProjectionSettings):
    """A projection for streaming: it uses the past and at most `lookahead` future frames."""

    lookahead: Annotated[int, Field(ge=0)]


class SpeechProjection(nn.Module):
    """Speech features per frame from an embedding of C named channels."""

    channel_indices: Tensor
    mean: Tensor
    std: Tensor

    def __init__(self, settings: SpeechProjectionSettings, names: Sequence[str]) -> None:
        """Raises InputError if a channel of the settings is not among the names."""
        super().__init__()
        self.channels = tuple(names) if settings.channels is None else _channels(settings.channels, names)
        self.register_buffer(
            "channel_indices", torch.tensor([list(names).index(name) for name in self.channels], dtype=torch.long)
        )
        self.register_buffer("mean", torch.zeros(len(names)))
        self.register_buffer("std", torch.ones(len(names)))
        self.drop = nn.Dropout1d(settings.channel_dropout)
        lookahead = settings.lookahead if isinstance(settings, CausalSpeechProjectionSettings) else None
        self.stack = ConvolutionStack(
            max(len(self.channels), 1), settings.width, settings.layers, settings.dropout, lookahead
        )

    def standardise_by(self, mean: Float[Tensor, " C"], std: Float[Tensor, " C"]) -> None:
        """Set the statistics of the train split; constant channels become zero."""
        self.mean.copy_(mean)
        self.std.copy_(torch.where(std > 1e-6, std, torch.inf))

    def forward(self, embedding: Float[Tensor, "B T C"]) -> Float[Tensor, "B T S"]:
        """Projected features."""
        features: Tensor = self.stack(self.drop(self.standardise(embedding).transpose(1, 2)).transpose(1, 2))
        return features

    def embedding_of(self, features: Float[ndarray, "*B T D"], names: Sequence[str]) -> Float[Tensor, "*B T C"]:
        """An embedding with these named features; channels that the network does not use are zero."""
        embedding = torch.zeros(*features.shape[:-1], len(self.mean))
        places = [names.index(name) for name in self.channels]
        embedding[..., self.channel_indices] = torch.from_numpy(features[..., places])
        return embedding

    def mean_features(self, frames: int) -> Float[Tensor, "1 T S"]:
        """Features of mean speech: all standardised channels are zero."""
        zeros = self.mean.new_zeros(1, frames, max(len(self.channel_indices), 1))
        features: Tensor = self.stack(zeros)
        return features

    def standardise(self, embedding: Float[Tensor, "B T C"]) -> Float[Tensor, "B T H"]:
        """Standardised input channels; one channel of zeros for a model without speech input."""
        if not len(self.channel_indices):
            return torch.zeros_like(embedding[..., :1])
        chosen = self.channel_indices
        return (embedding[..., chosen] - self.mean[chosen]) / self.std[chosen]


def _channels(chosen: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """The channels that are meant: a name, or the prefix of numbered ones."""
    found: list[str] = []
    for name in chosen:
        own = [each for each in names if each == name or each.rpartition("_")[0] == name]
        if not own:
            raise InputError(f"speech.channels: should be channels of the embedding, got {name}")
        found += own
    return tuple(found)
