"""Conditional VAE of head motion for streaming: a causal decoder, with latent codes sampled one at a time.

It is trained like `vae` (TalkingEyes eq. 8, 11 to 13). Each code is sampled from uniform numbers through the inverse
normal CDF, so that the codes of a longer speech start with the codes of a shorter one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.head.vae import VAEHead, VAEHeadSettings
from talkingeyes.models.layers.conditional_vae import VAESettings
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.layers.normaliser import MotionNormaliser
from talkingeyes.models.layers.uniform_rows import UniformRows


class CausalVAEHeadSettings(VAESettings, ComponentSettings):
    """Settings of the causal VAE of the head."""

    kind: Literal["causal_vae"]
    # Frames per latent code. One code per clip cannot be streamed.
    latent_frames: Annotated[int, Field(gt=0)]
    # Factor on the standard deviation of sampled codes.
    temperature: Annotated[float, Field(gt=0, le=1)]
    # Factor on the deviation of sampled heads from the mean pose, which the means of a VAE are drawn to.
    gain: Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class HeadState:
    """A stream between two frames: the next frame, the uniform numbers of its codes, what the decoder keeps."""

    frame: int
    codes: UniformRows
    past: Float[ndarray, "P W"]


class CausalVAEHead(nn.Module):
    """Generator of head rotation vectors from speech features, for whole clips or for streams."""

    settings_class = CausalVAEHeadSettings

    def __init__(self, settings: CausalVAEHeadSettings, speech: int) -> None:
        super().__init__()
        self.settings = settings
        size = settings.model_dump(exclude={"temperature", "gain"}) | {
            "kind": "vae",
            "norm": "standardised_mean",
            "standardised": True,
        }
        self.vae_head = VAEHead(VAEHeadSettings.model_validate(size), speech)
        vae = self.vae_head.vae
        vae.decoder = ConvolutionStack(
            settings.latent + speech, settings.width, settings.layers, settings.dropout, lookahead=0
        )

    @property
    def normal(self) -> MotionNormaliser:
        """Normalisation statistics of head motion."""
        return self.vae_head.normal

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Reconstruct true motion given its speech (training)."""
        return self.vae_head.predict(speech, head)

    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Sample head motion with codes from the prior, one seed per row."""
        rows = [self.uniform_codes(seed) for seed in seeds]
        codes = self.interpolate_latents(rows, [0] * len(seeds), speech.shape[1])
        decoder_input = torch.cat([codes.to(speech), speech], dim=-1)
        return self.decoded_head(self.decoder(decoder_input))

    def decoded_head(self, features: Float[Tensor, "B T W"]) -> Float[Tensor, "B T 3"]:
        """Head rotation vectors of features of the decoder."""
        return self.normal.denormalise(self.settings.gain * self.vae_head.vae.out(features))

    def streaming(self) -> StreamingHead:
        """The head for streams, which yield the result of `sample` part by part."""
        return StreamingHead(self)

    @property
    def decoder(self) -> ConvolutionStack:
        """The decoder of latent codes and speech."""
        return self.vae_head.vae.decoder

    def uniform_codes(self, seed: int) -> UniformRows:
        """The uniform numbers that the codes of a seed are drawn from."""
        return UniformRows(torch.Generator().manual_seed(seed), self.settings.latent)

    def interpolate_latents(
        self, rows: Sequence[UniformRows], first: Sequence[int], frames: int
    ) -> Float[Tensor, "B T Z"]:
        """Codes at their centres, interpolated at constant variance (as in ConditionalVAE), from frame `first` of each
        row on."""
        place = torch.tensor(first)[:, None] + torch.arange(frames)
        place = ((place + 0.5) / self.settings.latent_frames - 0.5).clamp(min=0)
        left = place.floor().long()
        share, begin = (place - left)[..., None], left[:, 0].tolist()
        count = int((left[:, -1] - left[:, 0]).max()) + 2
        uniform = torch.stack([each.rows(code, code + count) for each, code in zip(rows, begin, strict=True)])
        codes = self.settings.temperature * torch.special.ndtri(uniform.clamp(1e-7, 1 - 1e-7))
        at = (left - left[:, :1])[..., None].expand(-1, -1, codes.shape[-1])
        mixed = (1 - share) * codes.gather(1, at) + share * codes.gather(1, at + 1)
        out: Tensor = mixed / torch.hypot(share, 1 - share)
        return out


class StreamingHead:
    """Head motion of many streams, generated part by part."""

    def __init__(self, head: CausalVAEHead) -> None:
        self._head, self._decoder = head, head.decoder.streaming()

    def begin(self, seed: int) -> HeadState:
        """A stream before its first frame."""
        return HeadState(0, self._head.uniform_codes(seed), self._decoder.begin())

    def step(
        self, states: Sequence[HeadState], speech: Float[Tensor, "B T S"]
    ) -> tuple[Float[Tensor, "B T 3"], list[HeadState]]:
        """Head rotation vectors of the next frames of each stream, and the streams after them."""
        frames = speech.shape[1]
        codes = self._head.interpolate_latents([each.codes for each in states], [each.frame for each in states], frames)
        past = np.stack([each.past for each in states])
        decoded, past = self._decoder.step(past, torch.cat([codes, speech], dim=-1).numpy())
        after = [HeadState(each.frame + frames, each.codes, own.copy()) for each, own in zip(states, past, strict=True)]
        return self._head.decoded_head(torch.from_numpy(decoded)), after
