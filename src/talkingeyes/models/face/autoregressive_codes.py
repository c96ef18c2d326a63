"""Autoregressive prediction of codes of the face, after CodeTalker (Xing et al. 2023), deterministic or sampled.

A causal transformer predicts the latent of the next frame from the previous frames and the speech. It is replaced by
the nearest code, or by a code sampled by a softmax over distances, as ProbTalk3D's authors do in CodeTalker-ND.
CodeTalker feeds back the decoded face and decodes the prefix again at every step. Here the code values are fed back,
and decoded once at the end.
"""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.models.face.autoencoder import FaceAutoencoder, reconstruction
from talkingeyes.models.face.autoregression import AutoregressionSettings, AutoregressiveDecoder, mix_history
from talkingeyes.models.face.vqvae import FaceVQVAE
from talkingeyes.models.layers.transformer import shift_right


class AutoregressiveCodesFaceSettings(AutoregressionSettings):
    """Settings of the autoregression over codes."""

    kind: Literal["autoregressive_codes"]


class AutoregressiveCodesFace(nn.Module):
    """Predicts the codes of the next frame from those before it and the speech."""

    settings_class = AutoregressiveCodesFaceSettings

    def __init__(
        self, settings: AutoregressiveCodesFaceSettings, speech: int, face_dim: int, tokenizer: FaceAutoencoder | None
    ) -> None:
        super().__init__()
        if not isinstance(tokenizer, FaceVQVAE) or tokenizer.settings.layout != "frames":
            raise InputError("model.tokenizer: should be a codebook with layout frames for a face of codes")
        self.settings, self.tokenizer = settings, tokenizer
        self.decoder = AutoregressiveDecoder(settings, speech, tokenizer.predicted_dim, tokenizer.predicted_dim)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Do nothing: the tokenizer has its own statistics."""

    def loss_terms(self, speech: Float[Tensor, "B T S"], face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Mean squared errors of latents, expression and jaw. The history holds true codes, a fraction of them replaced
        by predictions."""
        true = self.tokenizer.latents(face)
        first = self._history(self.tokenizer.decoder_inputs(true))
        with torch.no_grad():
            own = self._history(self.tokenizer.decoder_inputs(self.decoder(speech, first)))
        latents = self.decoder(speech, mix_history(first, own, self.settings.own_history_fraction))
        reconstructed = self.tokenizer.decode(self.tokenizer.decoder_inputs(latents))
        return {
            "latent": F.mse_loss(latents.float(), true),
            **reconstruction(self.tokenizer.normal(reconstructed), self.tokenizer.normal(face), squared=True),
        }

    def sample(self, speech: Float[Tensor, "1 T S"], seeds: list[int], temperature: float) -> Float[Tensor, "B T F"]:
        """Generate frame by frame; at temperature 0, all seeds give the same face."""
        rows = len(seeds) if temperature else 1
        noise = self.tokenizer.noise(seeds[:rows], speech.shape[1], correlation_frames=1)
        decoding = self.decoder.start(speech.expand(rows, -1, -1))
        previous = torch.zeros((rows, self.tokenizer.predicted_dim), device=speech.device)
        values = []
        for position in range(speech.shape[1]):
            latents = decoding.decode_step(position, previous)[:, None]
            sampled = self.tokenizer.sample_decoder_inputs(latents, noise[:, position : position + 1], temperature)
            values.append(sampled)
            previous = (sampled / self.tokenizer.latent_scale)[:, 0]
        return self.tokenizer.decode(torch.cat(values, dim=1)).expand(len(seeds), -1, -1)

    def _history(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T L"]:
        """Code values before each frame, in units of the latents."""
        return shift_right(values.detach() / self.tokenizer.latent_scale)
