"""VAE of facial motion, the paper's comparison (ProbTalk3D section 3.4): a Gaussian latent per frame instead of codes.

Stage 2 predicts mean and log-variance of the latent of each frame; a sample of this Gaussian is decoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from talkingeyes.models.face.autoencoder import FaceAutoencoder, FaceAutoencoderSettings, reconstruction
from talkingeyes.models.layers.conditional_vae import DiagonalGaussian
from talkingeyes.models.layers.correlated_noise import correlated_normal

MAX_LOG_VARIANCE = 10.0  # bound on its absolute value


class FaceVAESettings(FaceAutoencoderSettings):
    """Settings of the VAE of the face."""

    kind: Literal["vae"]


class FaceVAE(FaceAutoencoder):
    """Encoder, Gaussian latent and decoder."""

    settings_class = FaceVAESettings

    def __init__(self, settings: FaceVAESettings, face_dim: int) -> None:
        super().__init__(settings, face_dim, 2 * settings.latent)
        self.settings, self.predicted_dim = settings, 2 * settings.latent

    def loss_terms(self, face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Eq. 4 with the KL divergence from N(0, I) instead of the quantisation loss."""
        posterior = _gaussian(self.encoder_decoder.encode(face))
        reconstructed = self.encoder_decoder.decode(posterior.rsample())
        return {"divergence": posterior.divergence(), **reconstruction(self.normal(reconstructed), self.normal(face))}

    def fit_latent_statistics(self, batches: Sequence[Float[Tensor, "B _ F"]]) -> None:
        """Do nothing: the prior N(0, I) sets the scale of latents."""

    def latents(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T Z"]:
        """Mean and log-variance."""
        return self.encoder_decoder.encode(face)

    def decoder_inputs(self, latents: Float[Tensor, "B T Z"]) -> Float[Tensor, "B T L"]:
        """A reparameterised sample."""
        return _gaussian(latents).rsample()

    def noise(self, seeds: list[int], frames: int, correlation_frames: int) -> Float[Tensor, "S T M"]:
        """One number per latent dimension and frame."""
        return correlated_normal(seeds, frames, self.settings.latent, correlation_frames)

    def sample_decoder_inputs(
        self, latents: Float[Tensor, "B T Z"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Float[Tensor, "S T L"]:
        """The mean plus `temperature` times the scaled noise."""
        gaussian = _gaussian(latents)
        return gaussian.mean + temperature * (0.5 * gaussian.log_variance).exp() * noise.to(latents)


def _gaussian(encoder_output: Float[Tensor, "B T Z"]) -> DiagonalGaussian:
    mean, log_variance = encoder_output.float().chunk(2, dim=-1)
    return DiagonalGaussian(mean, log_variance.clamp(-MAX_LOG_VARIANCE, MAX_LOG_VARIANCE))
