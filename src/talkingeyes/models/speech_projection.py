"""The trainable end of the speech encoder: standardises an embedding and projects it (A_1:T of the paper).

The packaged or loaded encoder itself is frozen and its output cached by the `embed` stage; this part is trained with
each model, as the paper trains a part of its encoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.convolution import CausalConvolutionStack, ConvolutionStack


class SpeechProjectionSettings(Settings):
    """Size of the projection."""

    # Channels of the embedding that are heard; null: all; none of them: the model is deaf, its features constant.
    channels: tuple[str, ...] | None
    width: Annotated[int, Field(gt=0)]
    # Convolutions of kernel 5 with dilation 1, 2, 4, ...: 3 layers reach 14 frames to each side.
    layers: Annotated[int, Field(ge=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Share of the embedding's channels that are hidden from a whole window in training.
    channel_dropout: Annotated[float, Field(ge=0, lt=1)]


class CausalSpeechProjectionSettings(SpeechProjectionSettings):
    """A projection for streams: it hears the past and no more than `lookahead` frames of what comes."""

    lookahead: Annotated[int, Field(ge=0)]


class SpeechProjection(nn.Module):
    """Speech features a frame from an embedding of C named channels."""

    channel_indices: Tensor
    mean: Tensor
    std: Tensor

    def __init__(self, settings: SpeechProjectionSettings, names: Sequence[str]) -> None:
        """Raises InputError if a channel of the settings is not among the names."""
        super().__init__()
        chosen = tuple(names) if settings.channels is None else settings.channels
        strange = [name for name in chosen if name not in names]
        if strange:
            raise InputError(f"speech.channels: should be channels of the embedding, got {', '.join(strange)}")
        self.register_buffer(
            "channel_indices", torch.tensor([list(names).index(name) for name in chosen], dtype=torch.long)
        )
        self.register_buffer("mean", torch.zeros(len(names)))
        self.register_buffer("std", torch.ones(len(names)))
        self.drop = nn.Dropout1d(settings.channel_dropout)
        size = (max(len(chosen), 1), settings.width, settings.layers, settings.dropout)
        lookahead = settings.lookahead if isinstance(settings, CausalSpeechProjectionSettings) else None
        self.stack = ConvolutionStack(*size) if lookahead is None else CausalConvolutionStack(*size, lookahead)

    def standardise_by(self, mean: Float[Tensor, " C"], std: Float[Tensor, " C"]) -> None:
        """Set the statistics of the train split; channels that never vary are left at zero."""
        self.mean.copy_(mean)
        self.std.copy_(torch.where(std > 1e-6, std, torch.inf))

    def forward(self, embedding: Float[Tensor, "B T C"]) -> Float[Tensor, "B T S"]:
        """Projected features."""
        features: Tensor = self.stack(self.drop(self.standardise(embedding).transpose(1, 2)).transpose(1, 2))
        return features

    def standardise(self, embedding: Float[Tensor, "B T C"]) -> Float[Tensor, "B T H"]:
        """The channels that are heard, in units of their standard deviations; of a deaf model, one of zeros."""
        if not len(self.channel_indices):
            return torch.zeros_like(embedding[..., :1])
        return ((embedding - self.mean) / self.std)[..., self.channel_indices]
