"""Stage 2 of ProbTalk3D (section 3.3.2, eq. 5): from speech and style to the latents of a frozen motion autoencoder.

A convolution and transformer layers predict all frames in parallel. The tokenizer samples codes (in the VAE variant,
from its Gaussian) and decodes them. With `correlation_frames` 1, codes are sampled independently in every frame, as in
the paper.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.layers.window_transformer import WindowTransformer, WindowTransformerSettings


class LatentFaceSettings(ComponentSettings):
    """Size of the network, and correlation time of the sampling noise."""

    kind: Literal["latent"]
    transformer: WindowTransformerSettings
    correlation_frames: Annotated[int, Field(gt=0)]


class LatentFace(nn.Module):
    """Predicts the latents z^a of speech to match the latents z^m of the face."""

    settings_class = LatentFaceSettings

    def __init__(
        self, settings: LatentFaceSettings, speech: int, face_dim: int, tokenizer: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        if tokenizer is None:
            raise InputError(
                "model.tokenizer: should name an autoencoder of conf/pretrain/ for a latent face, got null"
            )
        self.settings, self.tokenizer = settings, tokenizer
        self.transformer = WindowTransformer(settings.transformer, speech)
        self.out = nn.Linear(settings.transformer.width, tokenizer.predicted_dim)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Do nothing: the tokenizer has its own statistics."""

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Eq. 5: L1 of latents, expression and jaw."""
        latents = self._latents(speech)
        reconstructed = self.tokenizer.decode(self.tokenizer.decoder_inputs(latents))
        return {
            "latent": F.l1_loss(latents.float(), self.tokenizer.latents(face)),
            **reconstruction(self.tokenizer.normal(reconstructed), self.tokenizer.normal(face)),
        }

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Generate all frames in parallel."""
        latents = self._latents(speech)
        noise = self.tokenizer.noise(seeds, speech.shape[1], self.settings.correlation_frames)
        return self.tokenizer.decode(self.tokenizer.sample_decoder_inputs(latents, noise, temperature))

    def _latents(self, speech: Float[Tensor, "B T S"]) -> Float[Tensor, "B T Z"]:
        out: Tensor = self.out(self.transformer(speech))
        return out
