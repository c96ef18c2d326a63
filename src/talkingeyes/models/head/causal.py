"""The head's conditional VAE for streams: its decoder hears no frame ahead, and its codes are drawn one after another.

Trained as `vae` is (TalkingEyes eq. 8, 11 to 13). A code is drawn from uniform numbers by the inverse of the normal
distribution, so that the codes of a longer speech begin with those of a shorter one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.head.vae import VAEHead, VAEHeadSettings
from talkingeyes.models.layers.conditional_vae import VAESettings
from talkingeyes.models.layers.convolution import CausalConvolutionStack
from talkingeyes.models.layers.normal import Normal
from talkingeyes.settings import PartSettings


class CausalHeadSettings(VAESettings, PartSettings):
    """Size of the VAE of the head."""

    kind: Literal["causal_vae"]
    # Frames a code stands for; one a clip cannot be streamed.
    latent_frames: Annotated[int, Field(gt=0)]


@dataclass
class HeadStream:
    """Between two parts of a stream: what the decoder has heard, frames so far, the codes from number `first` on."""

    past: list[Tensor]
    frame: int
    generators: Sequence[torch.Generator]
    codes: list[Float[Tensor, "B Z"]]
    first: int


class CausalHead(nn.Module):
    """Head rotation vectors of speech features, whole or part by part."""

    configured_by = CausalHeadSettings

    def __init__(self, settings: CausalHeadSettings, speech: int) -> None:
        super().__init__()
        self.settings = settings
        size = settings.model_dump() | {"kind": "vae"}
        self.whole = VAEHead(VAEHeadSettings.model_validate(size), speech)
        self.whole.vae.decoder = CausalConvolutionStack(
            settings.latent + speech, settings.width, settings.layers, settings.dropout, ahead=0
        )

    @property
    def normal(self) -> Normal:
        """The statistics of the head."""
        return self.whole.normal

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Reconstruct true motion under its speech (training)."""
        return self.whole.predict(speech, head)

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Motions from codes drawn from N(0, I), a seed a row."""
        return self.step(speech, self.start(seeds))

    def start(self, seeds: Sequence[int]) -> HeadStream:
        """Before the first frame."""
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        return HeadStream(self._decoder.start(len(seeds)), 0, generators, [], 0)

    def step(self, speech: Float[Tensor, "B T S"], stream: HeadStream) -> Float[Tensor, "B T 3"]:
        """The head at the next frames; the stream moves on."""
        spread = self._spread(stream, speech.shape[1]).to(speech)
        stream.frame += speech.shape[1]
        vae = self.whole.vae
        return self.normal.back(vae.out(self._decoder.step(torch.cat([spread, speech], dim=-1), stream.past)))

    @property
    def _decoder(self) -> CausalConvolutionStack:
        assert isinstance(self.whole.vae.decoder, CausalConvolutionStack)
        return self.whole.vae.decoder

    def _spread(self, stream: HeadStream, frames: int) -> Float[Tensor, "B T Z"]:
        """Codes at their centres, interpolated to frames with their variance kept (as ConditionalVAE does)."""
        span = self.settings.latent_frames
        place = ((torch.arange(stream.frame, stream.frame + frames) + 0.5) / span - 0.5).clamp(min=0)
        left = place.floor().long()
        while stream.first + len(stream.codes) < int(left[-1]) + 2:
            stream.codes.append(self._draw(stream.generators))
        del stream.codes[: int(left[0]) - stream.first]
        stream.first = int(left[0])
        codes = torch.stack(stream.codes, dim=1)
        share, left = (place - left)[:, None], left - stream.first
        mixed = (1 - share) * codes[:, left] + share * codes[:, left + 1]
        out: Tensor = mixed / torch.hypot(share, 1 - share)
        return out

    def _draw(self, generators: Sequence[torch.Generator]) -> Float[Tensor, "B Z"]:
        uniform = torch.stack([torch.rand(self.settings.latent, generator=each) for each in generators])
        normal: Tensor = torch.special.ndtri(uniform.clamp(1e-7, 1 - 1e-7))
        return normal
