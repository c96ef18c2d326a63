"""Head poses by a VQ-VAE: codes of a few frames each, sampled autoregressively given speech.

TalkingEyes compares a VQ-VAE of the head with its VAE (section V-E). Here the codebook and the network that predicts
codes are trained together: the codebook by reconstruction and commitment (its eq. 7), the network by cross-entropy,
whose gradient does not reach the codebook.
"""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction
from talkingeyes.models.layers.convolution import ConvolutionStack
from talkingeyes.models.layers.quantiser_factory import AnyQuantiserSettings, make_quantiser
from talkingeyes.models.layers.transformer import CausalTransformer, TransformerSettings, shift_right


class VQVAEPoseSettings(ComponentSettings):
    """Sizes of the networks. A code spans `frames_per_code` frames."""

    width: Annotated[int, Field(gt=0)]
    layers: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    frames_per_code: Annotated[int, Field(gt=0)]
    quantiser: AnyQuantiserSettings
    transformer: TransformerSettings


class VQVAEPose(nn.Module):
    """Encoder, codebook, decoder, and a causal transformer over codes and speech, for `pose_dim` dimensions (vqvae.py:
    3)."""

    settings_class = VQVAEPoseSettings
    window = None

    def __init__(self, settings: VQVAEPoseSettings, speech: int, embedding: int, pose_dim: int = 6) -> None:
        super().__init__()
        self.settings = settings
        width, code, hidden = settings.width, settings.quantiser.width, settings.transformer.width
        self.encoder = ConvolutionStack(pose_dim, width, settings.layers, settings.dropout)
        self.to_latent = nn.Linear(width, code)
        self.quantiser = make_quantiser(settings.quantiser)
        self.decoder = ConvolutionStack(code, width, settings.layers, settings.dropout)
        self.out = nn.Linear(width, pose_dim)
        self.first = nn.Parameter(torch.zeros(1, 1, hidden))
        self.from_code = nn.Embedding(settings.quantiser.codes, hidden)
        self.from_speech = nn.Linear(speech, hidden)
        self.transformer = CausalTransformer(settings.transformer)
        self.scores = nn.Linear(hidden, settings.quantiser.codes)

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T P"]) -> PosePrediction:
        """Reconstruct through the codebook, and predict each code from the codes before it."""
        quantised = self.quantiser(self.to_latent(self._pool(self.encoder(pose))))
        generated = self._decode(quantised.values, pose.shape[1])
        before = shift_right(self.from_code(quantised.indices), self.first.expand(len(pose), 1, -1))
        scores = self.scores(self.transformer(before + self.from_speech(self._pool(inputs.features))))
        loss_terms = {
            "pose": losses.reconstruction(generated, pose),
            "motion": losses.velocity(generated, pose),
            "commitment": quantised.commitment,
            "codes": functional.cross_entropy(scores.flatten(0, 1), quantised.indices.flatten()),
        }
        return PosePrediction(generated, loss_terms)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B P"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T P"]:
        """Sample codes autoregressively and decode them."""
        speech = self.from_speech(self._pool(inputs.features))
        cache, before = self.transformer.start(), self.first.expand(len(generators), 1, -1)
        sampled_codes: list[Int[Tensor, " B"]] = []
        for position in range(speech.shape[1]):
            scores = self.scores(self.transformer.step(before + speech[:, position : position + 1], cache))[:, 0]
            probabilities = scores.softmax(-1).cpu()
            rows = [
                torch.multinomial(row, 1, generator=each) for row, each in zip(probabilities, generators, strict=True)
            ]
            sampled_codes.append(torch.cat(rows).to(speech.device))
            before = self.from_code(sampled_codes[-1])[:, None]
        return self._decode(self.quantiser.codebook[torch.stack(sampled_codes, dim=1)], inputs.features.shape[1])

    def _pool(self, frames: Float[Tensor, "B T W"]) -> Float[Tensor, "B N W"]:
        """Means over the frames of each code; the last code may span fewer frames."""
        span = self.settings.frames_per_code
        return torch.stack([part.mean(1) for part in frames.split(span, dim=1)], dim=1)

    def _decode(self, values: Float[Tensor, "B N C"], frames: int) -> Float[Tensor, "B T P"]:
        spread = values.repeat_interleave(self.settings.frames_per_code, dim=1)[:, :frames]
        generated: Tensor = self.out(self.decoder(spread))
        return generated
