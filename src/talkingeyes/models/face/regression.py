"""A face by autoregressive regression in the manner of FaceFormer (Fan et al. 2022): deterministic.

A causal transformer over past frames of the face, with attention to the speech around its own frame (FaceFormer's
alignment bias, widened), says the next frame. FaceFormer is trained by running it frame by frame; here a share of the
history is what the model itself says in a first pass over all frames (Mihaylova & Martins 2019), which costs two passes
instead of as many as there are frames. Style multiplies the speech, as in all models of the comparison.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.layers.normal import Normal
from talkingeyes.models.layers.transformer import CausalTransformer, CrossWindow, TransformerSettings, shifted


class AutoregressionSettings(PartSettings):
    """A decoder that sees its own past."""

    transformer: TransformerSettings
    # Frames of speech that cross-attention sees before and after its own.
    speech_back: Annotated[int, Field(ge=0)]
    speech_ahead: Annotated[int, Field(ge=0)]
    # Share of past frames that are, in training, the model's own.
    own_history: Annotated[float, Field(ge=0, le=1)]


class RegressionFaceSettings(AutoregressionSettings):
    """Nothing more."""

    kind: Literal["regression"]


class RegressionFace(nn.Module):
    """The next frame of a face from those before it and the speech."""

    configured_by = RegressionFaceSettings

    def __init__(
        self, settings: RegressionFaceSettings, speech: int, numbers: int, prior: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        self.settings, self.normal = settings, Normal(numbers)
        self.decoder = HistoryDecoder(settings, speech, numbers, numbers)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set what faces are centred on and divided by."""
        self.normal.set(mean, scale)

    def terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """L1 of expression and jaw; beside them what copying the last frame gives."""
        true = self.normal(face)
        first = shifted(true, torch.zeros_like(true[:, :1]))
        with torch.no_grad():
            own = shifted(self.decoder(speech, first), first[:, :1])
        predicted = self.decoder(speech, mixed(first, own, self.settings.own_history))
        copied = reconstruction(first, true)["expression"]
        return {**reconstruction(predicted, true), "copy_last": copied.detach()}

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Frame after frame; nothing is drawn."""
        frames = []
        before = torch.zeros_like(self.normal.mean).expand(1, -1)
        steps = self.decoder.start(speech)
        for position in range(speech.shape[1]):
            before = steps.next(position, before)
            frames.append(before)
        return self.normal.back(torch.stack(frames, dim=1)).expand(len(seeds), -1, -1)


class HistoryDecoder(nn.Module):
    """A causal transformer over a history of `given` numbers a frame, with speech as memory, giving `told` numbers."""

    def __init__(self, settings: AutoregressionSettings, speech: int, given: int, told: int) -> None:
        super().__init__()
        width = settings.transformer.width
        self.embed = nn.Linear(given, width)
        self.memory = nn.Linear(speech, width)
        window = CrossWindow(settings.speech_back, settings.speech_ahead)
        self.transformer = CausalTransformer(settings.transformer, window)
        self.out = nn.Linear(width, told)

    def forward(self, speech: Float[Tensor, "B T S"], history: Float[Tensor, "B T H"]) -> Float[Tensor, "B T O"]:
        """All frames at once, `history` being the frame before each."""
        memory = self.memory(speech)
        out: Tensor = self.out(self.transformer(self.embed(history) + memory, memory))
        return out

    def start(self, speech: Float[Tensor, "B T S"]) -> Steps:
        """The same, frame by frame."""
        return Steps(self, self.memory(speech))


class Steps:
    """A decoding under way: the cache of the transformer beside the memory."""

    def __init__(self, decoder: HistoryDecoder, memory: Float[Tensor, "B T W"]) -> None:
        self.decoder, self.memory = decoder, memory
        self.cache = decoder.transformer.start(memory)

    def next(self, position: int, before: Float[Tensor, "B H"]) -> Float[Tensor, "B O"]:
        """What the decoder tells of a frame, given the frame before it."""
        x = self.decoder.embed(before)[:, None] + self.memory[:, position : position + 1]
        out: Tensor = self.decoder.out(self.decoder.transformer.step(x, self.cache))[:, 0]
        return out


def mixed(true: Float[Tensor, "B T H"], own: Float[Tensor, "B T H"], share: float) -> Float[Tensor, "B T H"]:
    """A share of the frames of a history replaced by the model's own."""
    replaced = torch.rand(true.shape[:2], device=true.device) < share
    return torch.where(replaced[..., None], own, true)
