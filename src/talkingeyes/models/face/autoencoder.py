"""Interface of the motion autoencoders of the face (ProbTalk3D section 3.3.1): stage 1, the frozen tokenizer of stage
2.

The encoder consists of a linear layer, a convolution and a transformer; the decoder mirrors it. The latent of a frame
consists of codes (`vqvae`) or is Gaussian (`vae`). Stage 2 predicts `latents` from speech; `decoder_inputs` passes
gradients to them; `sample_decoder_inputs` samples from them; `decode` yields the face.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import BeforeValidator, Field, SerializeAsAny
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings
from talkingeyes.models.face.basis import JAW_DIM
from talkingeyes.models.layers.freezing import FreezableModule
from talkingeyes.models.layers.normaliser import MotionNormaliser
from talkingeyes.models.layers.window_transformer import WindowTransformer, WindowTransformerSettings


class FaceAutoencoderSettings(ComponentSettings):
    """Sizes common to both kinds."""

    # Width of the latent of a frame (the paper: 256).
    latent: Annotated[int, Field(gt=0)]
    encoder: WindowTransformerSettings
    decoder: WindowTransformerSettings


class EncoderDecoder(nn.Module):
    """Encoder and decoder around a latent, with the statistics of faces; part of both kinds."""

    def __init__(self, settings: FaceAutoencoderSettings, face_dim: int, encoder_dim: int) -> None:
        """`encoder_dim`: outputs of the encoder per frame."""
        super().__init__()
        self.normal = MotionNormaliser(face_dim)
        self.encoder = WindowTransformer(settings.encoder, face_dim)
        self.to_latent = nn.Linear(settings.encoder.width, encoder_dim)
        self.decoder = WindowTransformer(settings.decoder, settings.latent)
        self.out = nn.Linear(settings.decoder.width, face_dim)

    def encode(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T E"]:
        """Outputs of the encoder for a face."""
        out: Tensor = self.to_latent(self.encoder(self.normal(face)))
        return out

    def decode(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T F"]:
        """Faces decoded from latents."""
        return self.normal.denormalise(self.out(self.decoder(values)))


class FaceAutoencoder(FreezableModule, ABC):
    """A motion autoencoder `Class(settings, face_dim)`; `face_dim`: numbers of expression and jaw per frame."""

    settings_class: Any
    # Dimensions of the `latents` of a frame that stage 2 predicts.
    predicted_dim: int

    def __init__(self, settings: FaceAutoencoderSettings, face_dim: int, encoder_dim: int) -> None:
        """`encoder_dim`: outputs of the encoder per frame."""
        super().__init__()
        self.encoder_decoder = EncoderDecoder(settings, face_dim, encoder_dim)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set mean and scale of faces."""
        self.encoder_decoder.normal.set(mean, scale)

    def normal(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Normalised faces."""
        out: Tensor = self.encoder_decoder.normal(face)
        return out

    def decode(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T F"]:
        """The decoded face, normalisation undone."""
        return self.encoder_decoder.decode(values)

    @abstractmethod
    def loss_terms(self, face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Named loss terms of stage 1."""

    @abstractmethod
    def fit_latent_statistics(self, batches: Sequence[Float[Tensor, "B _ F"]]) -> None:
        """Set the statistics of the latents from batches of training faces, after stage 1."""

    @abstractmethod
    def latents(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T Z"]:
        """Targets of stage 2 for a face, scaled by the statistics of the training faces."""

    @abstractmethod
    def decoder_inputs(self, latents: Float[Tensor, "B T Z"]) -> Float[Tensor, "B T L"]:
        """Decoder inputs for predicted latents in training; passes gradients."""

    @abstractmethod
    def noise(self, seeds: list[int], frames: int, correlation_frames: int) -> Float[Tensor, "S T M"]:
        """Standard normal noise for sampling, one seed per row, correlated over `correlation_frames` frames."""

    @abstractmethod
    def sample_decoder_inputs(
        self, latents: Float[Tensor, "B T Z"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Float[Tensor, "S T L"]:
        """Decoder inputs in generation (B is S or 1); temperature 0 ignores the noise."""


FACE_AUTOENCODERS = ComponentRegistry(
    "motion autoencoder of the face",
    {
        "vq": "talkingeyes.models.face.vqvae:FaceVQVAE",
        "vae": "talkingeyes.models.face.vae:FaceVAE",
    },
    ("freeze", *(name for name in vars(FaceAutoencoder) if not name.startswith("_"))),
)
FaceAutoencoderComponentSettings = Annotated[
    SerializeAsAny[ComponentSettings], BeforeValidator(FACE_AUTOENCODERS.parse)
]


def reconstruction(
    predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"], squared: bool = False
) -> dict[str, Tensor]:
    """Error of expression and of jaw, each a mean over its dimensions, in normalised units: L1 (eq. 4 and 5), or
    squared."""
    error = F.mse_loss if squared else F.l1_loss
    return {
        "expression": error(predicted[..., :-JAW_DIM].float(), true[..., :-JAW_DIM]),
        "jaw": error(predicted[..., -JAW_DIM:].float(), true[..., -JAW_DIM:]),
    }
