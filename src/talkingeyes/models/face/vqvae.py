"""VQ-VAE of facial motion (ProbTalk3D section 3.3.1, eq. 3 and 4): 256 codes of 128 numbers, latents of 256.

`layout` sets what a code represents. `frames`: the latent of a frame is cut into pieces of the width of a code, so that
a code describes one frame. `channels`, as in the released program: latents are laid out channel by channel before they
are cut, so that a code represents 128 consecutive values over time, across the border of two channels where the number
of frames is no multiple of 128, and a change of one frame changes a code of each channel. See docs/face_models.md.

The codebook term of eq. 3 is minimised in closed form (layers/quantiser.py); the commitment term is as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float, Int
from pydantic import model_validator
from torch import Tensor

from talkingeyes.core.settings import bounds_error
from talkingeyes.models.face.autoencoder import FaceAutoencoder, FaceAutoencoderSettings, reconstruction
from talkingeyes.models.layers.correlated_noise import correlated_normal, normal_to_gumbel
from talkingeyes.models.layers.quantiser_factory import AnyQuantiserSettings, make_quantiser

CodeLayout = Literal["frames", "channels"]


class FaceVQVAESettings(FaceAutoencoderSettings):
    """Settings of the codebook and its layout."""

    kind: Literal["vq"]
    layout: CodeLayout
    quantiser: AnyQuantiserSettings

    @model_validator(mode="after")
    def _whole_codes(self) -> FaceVQVAESettings:
        if self.latent % self.quantiser.width:
            raise bounds_error(f"latent should be a multiple of quantiser.width, {self.quantiser.width}", self.latent)
        return self


def split_codes(latents: Float[Tensor, "B T L"], layout: CodeLayout, width: int) -> Float[Tensor, "B N C"]:
    """Cut latents into pieces of the width of a code."""
    ordered = latents if layout == "frames" else latents.transpose(1, 2)
    return ordered.reshape(len(latents), -1, width)


def merge_codes(pieces: Float[Tensor, "B N C"], layout: CodeLayout, latent: int) -> Float[Tensor, "B T L"]:
    """The inverse of `split_codes`."""
    if layout == "frames":
        return pieces.reshape(len(pieces), -1, latent)
    return pieces.reshape(len(pieces), latent, -1).transpose(1, 2)


class FaceVQVAE(FaceAutoencoder):
    """Encoder, codebook and decoder. `temperature_scale` is the mean squared distance of the training latents from
    their codes, the unit of temperatures. `latent_scale` is their root mean square, the unit of the targets of stage
    2."""

    temperature_scale: Tensor
    latent_scale: Tensor
    settings_class = FaceVQVAESettings

    def __init__(self, settings: FaceVQVAESettings, face_dim: int) -> None:
        super().__init__(settings, face_dim, settings.latent)
        self.settings, self.predicted_dim = settings, settings.latent
        self.quantiser = make_quantiser(settings.quantiser)
        self.register_buffer("temperature_scale", torch.ones(()))
        self.register_buffer("latent_scale", torch.ones(()))

    def loss_terms(self, face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Eq. 4: quantisation, expression and jaw."""
        quantised = self.quantiser(self._split_codes(self.encoder_decoder.encode(face)))
        reconstructed = self.encoder_decoder.decode(self._merge_codes(quantised.values))
        beta = self.settings.quantiser.commitment
        return {
            "quantisation": beta * quantised.commitment,
            **reconstruction(self.normal(reconstructed), self.normal(face)),
        }

    @torch.no_grad()
    def fit_latent_statistics(self, batches: Sequence[Float[Tensor, "B _ F"]]) -> None:
        """Set `temperature_scale` and `latent_scale` from faces, once after stage 1."""
        distances, squares = [], []
        for face in batches:
            latents = self.encoder_decoder.encode(face)
            pieces = self._split_codes(latents)
            distances.append((pieces - self.quantiser(pieces).values).square().sum(-1).flatten())
            squares.append(latents.square().flatten())
        self.temperature_scale.copy_(torch.cat(distances).mean())
        self.latent_scale.copy_(torch.cat(squares).mean().sqrt())

    def latents(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T L"]:
        """z^m of eq. 5."""
        return self.encoder_decoder.encode(face) / self.latent_scale

    def decoder_inputs(self, latents: Float[Tensor, "B T L"]) -> Float[Tensor, "B T L"]:
        """Nearest codes, straight through."""
        return self._merge_codes(self.quantiser(self._split_codes(latents * self.latent_scale)).values)

    def noise(self, seeds: list[int], frames: int, correlation_frames: int) -> Float[Tensor, "S T M"]:
        """One number per code and piece of a frame's latent."""
        places = self.settings.latent // self.settings.quantiser.width
        return correlated_normal(seeds, frames, places * self.settings.quantiser.codes, correlation_frames)

    def sample_decoder_inputs(
        self, latents: Float[Tensor, "B T L"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Float[Tensor, "S T L"]:
        """Values of sampled codes."""
        return self._merge_codes(self.quantiser.codebook[self.codes(latents, noise, temperature)])

    def codes(
        self, latents: Float[Tensor, "B T L"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Int[Tensor, "S N"]:
        """Codes sampled by a softmax over negative squared distances in units of `temperature` times
        `temperature_scale` (section 3.3.3), with the Gumbel-max trick."""
        distances = self.quantiser.distances(self._split_codes(latents * self.latent_scale))
        if temperature == 0:
            return distances.argmin(-1).expand(len(noise), -1)
        logits = -distances / (temperature * self.temperature_scale)
        gumbel = normal_to_gumbel(noise.to(logits)).reshape(len(noise), -1, logits.shape[-1])
        return (logits + gumbel).argmax(-1)

    def _split_codes(self, latents: Float[Tensor, "B T L"]) -> Float[Tensor, "B N C"]:
        return split_codes(latents, self.settings.layout, self.settings.quantiser.width)

    def _merge_codes(self, pieces: Float[Tensor, "B N C"]) -> Float[Tensor, "B T L"]:
        return merge_codes(pieces, self.settings.layout, self.settings.latent)
