"""Conditional VAE of head motion for streaming: a causal decoder, with latent codes sampled one at a time.

It is trained like `vae` (TalkingEyes eq. 8, 11 to 13). Each code is sampled from uniform numbers through the inverse
normal CDF, so that the codes of a longer speech start with the codes of a shorter one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.head.vae import VAEHead, VAEHeadSettings
from talkingeyes.models.layers.conditional_vae import VAESettings
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.layers.normaliser import MotionNormaliser


class CausalVAEHeadSettings(VAESettings, ComponentSettings):
    """Settings of the causal VAE of the head."""

    kind: Literal["causal_vae"]
    # Frames per latent code. One code per clip cannot be streamed.
    latent_frames: Annotated[int, Field(gt=0)]
    # Factor on the standard deviation of sampled codes.
    temperature: Annotated[float, Field(gt=0, le=1)]
    # Factor on the deviation of sampled heads from the mean pose, which the means of a VAE are drawn to.
    gain: Annotated[float, Field(gt=0)]


@dataclass
class _LatentState:
    """Latent codes sampled so far for a batch: the index of the next frame, and the codes from index `first` on."""

    generators: Sequence[torch.Generator]
    frame: int = 0
    first: int = 0
    codes: list[Float[Tensor, "B Z"]] = field(default_factory=list)

    @classmethod
    def of(cls, seeds: Sequence[int]) -> _LatentState:
        """The state before the first frame."""
        return cls([torch.Generator().manual_seed(seed) for seed in seeds])

    @property
    def next_code(self) -> int:
        """Index of the code that is sampled next."""
        return self.first + len(self.codes)


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
        codes = self.interpolate_latents(_LatentState.of(seeds), speech.shape[1])
        decoder_input = torch.cat([codes.to(speech), speech], dim=-1)
        return self.decoded_head(self.decoder(decoder_input))

    def decoded_head(self, features: Float[Tensor, "B T W"]) -> Float[Tensor, "B T 3"]:
        """Head rotation vectors of features of the decoder."""
        return self.normal.denormalise(self.settings.gain * self.vae_head.vae.out(features))

    def stream(self, seed: int) -> HeadStream:
        """A stream that yields the result of `sample` part by part."""
        return HeadStream(self, seed)

    @property
    def decoder(self) -> ConvolutionStack:
        """The decoder of latent codes and speech."""
        return self.vae_head.vae.decoder

    def interpolate_latents(self, latent_state: _LatentState, frames: int) -> Float[Tensor, "B T Z"]:
        """Codes at their centres, interpolated to the next frames at constant variance (as in ConditionalVAE)."""
        span = self.settings.latent_frames
        place = ((torch.arange(latent_state.frame, latent_state.frame + frames) + 0.5) / span - 0.5).clamp(min=0)
        left = place.floor().long()
        latent_state.frame += frames
        while latent_state.next_code < int(left[-1]) + 2:
            latent_state.codes.append(self._draw(latent_state))
        del latent_state.codes[: int(left[0]) - latent_state.first]
        latent_state.first = int(left[0])
        codes = torch.stack(latent_state.codes, dim=1)
        share, left = (place - left)[:, None], left - latent_state.first
        mixed = (1 - share) * codes[:, left] + share * codes[:, left + 1]
        out: Tensor = mixed / torch.hypot(share, 1 - share)
        return out

    def _draw(self, latent_state: _LatentState) -> Float[Tensor, "B Z"]:
        uniform = torch.stack([torch.rand(self.settings.latent, generator=each) for each in latent_state.generators])
        code: Tensor = self.settings.temperature * torch.special.ndtri(uniform.clamp(1e-7, 1 - 1e-7))
        return code


class HeadStream:
    """Head motion of one seed, generated part by part."""

    def __init__(self, head: CausalVAEHead, seed: int) -> None:
        self._head, self._codes, self._decoder = head, _LatentState.of([seed]), head.decoder.stream()

    def step(self, speech: Float[Tensor, "1 T S"]) -> Float[Tensor, "1 T 3"]:
        """Head rotation vectors of the next frames."""
        codes = self._head.interpolate_latents(self._codes, speech.shape[1])
        decoded = torch.from_numpy(self._decoder.step(torch.cat([codes, speech], dim=-1)[0].numpy()))[None]
        return self._head.decoded_head(decoded)
