"""Contract of the motion autoencoders of the face (ProbTalk3D section 3.3.1): stage 1, the frozen tokenizer of stage 2.

Encoder: linear, convolution, transformer; decoder: the same back. Between them stands what a latent of a frame is made
of: codes (`vqvae`) or a Gaussian (`vae`). Stage 2 predicts `latents` from speech, `decoder_inputs` passes gradients to
them, `sample_decoder_inputs` samples them, `decode` gives the face.
"""

from __future__ import annotations

from typing import Annotated, Any, Protocol, runtime_checkable

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import BeforeValidator, Field, SerializeAsAny
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentRegistry, ComponentSettings
from talkingeyes.models.face.basis import JAW_DIM
from talkingeyes.models.layers.normaliser import MotionNormaliser
from talkingeyes.models.layers.window_transformer import WindowTransformer, WindowTransformerSettings

FACE_AUTOENCODERS = ComponentRegistry(
    "motion autoencoder of the face",
    {
        "vq": "talkingeyes.models.face.vqvae:FaceVQVAE",
        "vae": "talkingeyes.models.face.vae:FaceVAE",
    },
    (
        "normalise_by",
        "normal",
        "freeze",
        "loss_terms",
        "fit_latent_statistics",
        "latents",
        "decoder_inputs",
        "noise",
        "sample_decoder_inputs",
        "decode",
    ),
)
FaceAutoencoderComponentSettings = Annotated[
    SerializeAsAny[ComponentSettings], BeforeValidator(FACE_AUTOENCODERS.parse)
]


class FaceAutoencoderSettings(ComponentSettings):
    """Sizes that both kinds share."""

    # Width of the latent of a frame (the paper: 256).
    latent: Annotated[int, Field(gt=0)]
    encoder: WindowTransformerSettings
    decoder: WindowTransformerSettings


@runtime_checkable
class FaceAutoencoder(Protocol):
    """The role: a torch module made as `Class(settings, face_dim)`, `face_dim` of expression and jaw a frame."""

    settings_class: Any
    # Numbers of a frame's `latents`: what stage 2 predicts.
    predicted_dim: int

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Take what faces are centred on and divided by."""
        ...

    def normal(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Faces in units of the scale."""
        ...

    def freeze(self) -> None:
        """Keep everything as it is while stage 2 is trained."""
        ...

    def loss_terms(self, face: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
        """Named terms of the loss of stage 1."""
        ...

    def latents(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T Z"]:
        """What stage 2 is to predict of a face, in units of what the training faces have."""
        ...

    def decoder_inputs(self, latents: Float[Tensor, "B T Z"]) -> Float[Tensor, "B T L"]:
        """What the decoder is given for predicted latents in training; gradients pass."""
        ...

    def fit_latent_statistics(self, face: Float[Tensor, "B T F"]) -> None:
        """Take what it knows of its own latents from training faces, when stage 1 has ended."""
        ...

    def noise(self, seeds: list[int], frames: int, correlation_frames: int) -> Float[Tensor, "S T M"]:
        """Standard normal numbers of draws, a seed a row; they change over `correlation_frames` frames."""
        ...

    def sample_decoder_inputs(
        self, latents: Float[Tensor, "B T Z"], noise: Float[Tensor, "S T M"], temperature: float
    ) -> Float[Tensor, "S T L"]:
        """What the decoder is given in generation (B is S or 1); at temperature 0 noise counts for nothing."""
        ...

    def decode(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T F"]:
        """The face, in its own units."""
        ...


class EncoderDecoder(nn.Module):
    """Encoder and decoder around a latent, with the statistics of faces; both kinds hold one."""

    def __init__(self, settings: FaceAutoencoderSettings, face_dim: int, encoder_dim: int) -> None:
        """`encoder_dim`: what the encoder gives a frame."""
        super().__init__()
        self.normal = MotionNormaliser(face_dim)
        self.encoder = WindowTransformer(settings.encoder, face_dim)
        self.to_latent = nn.Linear(settings.encoder.width, encoder_dim)
        self.decoder = WindowTransformer(settings.decoder, settings.latent)
        self.out = nn.Linear(settings.decoder.width, face_dim)

    def encode(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T E"]:
        """What the encoder says of a face."""
        out: Tensor = self.to_latent(self.encoder(self.normal(face)))
        return out

    def decode(self, values: Float[Tensor, "B T L"]) -> Float[Tensor, "B T F"]:
        """The face of latents."""
        return self.normal.denormalise(self.out(self.decoder(values)))


class FaceAutoencoderBase(nn.Module):
    """What both kinds of autoencoder have around their latent."""

    def __init__(self, settings: FaceAutoencoderSettings, face_dim: int, encoder_dim: int) -> None:
        super().__init__()
        self.encoder_decoder = EncoderDecoder(settings, face_dim, encoder_dim)
        self.frozen = False

    def freeze(self) -> None:
        """Keep everything as it is while stage 2 is trained."""
        self.frozen = True
        self.requires_grad_(False)
        self.eval()

    def train(self, mode: bool = True) -> FaceAutoencoderBase:
        """What is frozen stays in evaluation mode."""
        return super().train(mode and not self.frozen)

    def normalise_by(self, mean: Float[Tensor, " F"], scale: Float[Tensor, " F"]) -> None:
        """Set what faces are centred on and divided by."""
        self.encoder_decoder.normal.set(mean, scale)

    def normal(self, face: Float[Tensor, "B T F"]) -> Float[Tensor, "B T F"]:
        """Faces in units of the scale."""
        out: Tensor = self.encoder_decoder.normal(face)
        return out


def reconstruction(predicted: Float[Tensor, "B T F"], true: Float[Tensor, "B T F"]) -> dict[str, Tensor]:
    """L1 of expression and of jaw, each a mean over its numbers (eq. 4 and 5), in units of the scale."""
    return {
        "expression": F.l1_loss(predicted[..., :-JAW_DIM].float(), true[..., :-JAW_DIM]),
        "jaw": F.l1_loss(predicted[..., -JAW_DIM:].float(), true[..., -JAW_DIM:]),
    }
