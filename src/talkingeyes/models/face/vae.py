"""The VAE of facial motion, the paper's comparison (ProbTalk3D section 3.4): a Gaussian a frame in place of codes.

Stage 2 predicts mean and log-variance of the latent of each frame; a draw from that Gaussian is decoded.
"""

from __future__ import annotations

from typing import Literal

from jaxtyping import Float
from torch import Tensor

from talkingeyes.models.face.autoencoder import AutoencoderSettings, Coded, reconstruction
from talkingeyes.models.layers.conditional_vae import Gaussian
from talkingeyes.models.layers.slow_noise import slow_normal

LOG_VARIANCE = 10.0  # the most, either way


class FaceVAESettings(AutoencoderSettings):
    """Nothing but the sizes."""

    kind: Literal["vae"]


class FaceVAE(Coded):
    """E, the Gaussian and D."""

    configured_by = FaceVAESettings

    def __init__(self, settings: FaceVAESettings, numbers: int) -> None:
        super().__init__(settings, numbers, 2 * settings.latent)
        self.settings, self.predicted = settings, 2 * settings.latent

    def terms(self, face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Eq. 4 with the divergence from N(0, I) in place of the quantisation."""
        posterior = _gaussian(self.coder.encode(face))
        again = self.coder.decode(posterior.draw())
        return {"divergence": posterior.divergence(), **reconstruction(self.normal(again), self.normal(face))}

    def measure(self, face: Float[Tensor, "B T F"]) -> None:
        """The prior is N(0, I): latents have a unit already."""

    def latents(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T Z"]:
        """Mean and log-variance."""
        return self.coder.encode(face)

    def through(self, latents: Float[Tensor, "B T Z"]) -> Float[Tensor, "B T L"]:
        """A reparameterised draw."""
        return _gaussian(latents).draw()

    def noise(self, seeds: list[int], frames: int, slow_frames: int) -> Float[Tensor, "S T M"]:
        """A number for each of the latent."""
        return slow_normal(seeds, frames, self.settings.latent, slow_frames)

    def drawn(
        self, latents: Float[Tensor, "B T Z"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Float[Tensor, "S T L"]:
        """The mean and `temperature` times the deviation."""
        gaussian = _gaussian(latents)
        return gaussian.mean + temperature * (0.5 * gaussian.log_variance).exp() * noise.to(latents)

    def decode(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T F"]:
        """D of latents."""
        return self.coder.decode(values)


def _gaussian(encoded: Float[Tensor, "B T Z"]) -> Gaussian:
    mean, log_variance = encoded.float().chunk(2, dim=-1)
    return Gaussian(mean, log_variance.clamp(-LOG_VARIANCE, LOG_VARIANCE))
