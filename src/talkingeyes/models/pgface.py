"""PGFace: face shape from speech and head pose (Zhang et al., section 4.2, eq. 7 and 8).

A window of 16 frames of speech and poses predicts the shape at its 8th frame, as 64 coefficients of a shape basis (the
paper's expression basis has 64). The losses are those of vertices: squared distances of shapes, and of their
differences to the next frame, both weighted by the mask m, which is 10 on the lower face. Vertices are linear in the
coefficients, so a sum over all vertices is computed as a quadratic form of coefficients. Eq. 6 is missing from the text
that we have. We assume f = PGFace(x, p).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.settings import Settings
from talkingeyes.models.speech_projection import SpeechProjection, SpeechProjectionSettings

WINDOWS_AT_ONCE = 256


class PGFaceNetworkSettings(Settings):
    """Size of the network, and its losses."""

    speech: SpeechProjectionSettings
    width: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Frames of a window, and the one whose shape is predicted, counted from 1 (the paper: 16 and 8).
    window: Annotated[int, Field(gt=1)]
    output_frame: Annotated[int, Field(gt=0)]
    coefficients: Annotated[int, Field(gt=0)]
    # m of eq. 7 on the lower face; 1 elsewhere.
    lower_face_weight: Annotated[float, Field(ge=1)]
    # mu_1 and mu_2 of eq. 8.
    shape_weight: Annotated[float, Field(ge=0)]
    motion_weight: Annotated[float, Field(ge=0)]


class PGFace(nn.Module):
    """Predicts coefficients in units of their standard deviations. `mean`, `basis`: the vertices (metres) of
    coefficients."""

    mean: Tensor
    basis: Tensor
    weighted_gram: Tensor
    pose_scale: Tensor

    def __init__(self, settings: PGFaceNetworkSettings, channels: Sequence[str], vertices: int) -> None:
        super().__init__()
        self.settings = settings
        count, width = settings.coefficients, settings.width
        self.speech = SpeechProjection(settings.speech, channels)
        self.input_projection = nn.Linear(settings.speech.width + 6, width)
        self.convolutions = nn.ModuleList(nn.Conv1d(width, width, 3, padding=1) for _ in range(2))
        self.drop = nn.Dropout(settings.dropout)
        self.out = nn.Linear(width * settings.window, count)
        self.register_buffer("mean", torch.zeros(vertices, 3))
        self.register_buffer("basis", torch.zeros(count, vertices, 3))
        self.register_buffer("weighted_gram", torch.eye(count))
        self.register_buffer("pose_scale", torch.ones(6))

    def set_basis(self, mean: Float[Tensor, "V 3"], basis: Float[Tensor, "K V 3"], lower: Tensor) -> None:
        """Set the basis, and the quadratic form of the masked sum over vertices (square millimetres)."""
        self.mean.copy_(mean)
        self.basis.copy_(basis)
        mask = torch.where(lower, self.settings.lower_face_weight, 1.0)[:, None]
        masked = (1000.0 * basis * mask).flatten(1)
        self.weighted_gram.copy_(masked @ masked.T / (3 * len(mean)))

    def forward(self, speech: Float[Tensor, "B W C"], pose: Float[Tensor, "B W 6"]) -> Float[Tensor, "B K"]:
        """Coefficients of the output frame of each window."""
        h = self.input_projection(torch.cat([self.speech(speech), pose / self.pose_scale], dim=-1)).transpose(1, 2)
        for convolution in self.convolutions:
            h = h + self.drop(functional.leaky_relu(convolution(h), 0.2))
        coefficients: Tensor = self.out(h.flatten(1))
        return coefficients

    def shapes(self, coefficients: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Vertices in head coordinates."""
        return self.mean + torch.einsum("bk,kvc->bvc", coefficients, self.basis)

    @torch.no_grad()
    def sequence(self, speech: Float[Tensor, "T C"], pose: Float[Tensor, "T 6"]) -> Float[Tensor, "T K"]:
        """Coefficients of every frame; the first and the last frame are repeated for the windows at the ends."""
        before = self.settings.output_frame - 1
        frames = torch.arange(len(speech))[:, None] + torch.arange(self.settings.window) - before
        cut = frames.clamp(0, len(speech) - 1)
        return torch.cat([self(speech[each], pose[each]) for each in cut.split(WINDOWS_AT_ONCE)])

    def masked_squared_error(self, difference: Float[Tensor, "B K"]) -> Float[Tensor, ""]:
        """Eq. 7 of a difference: the masked square, mean over vertices and coordinates."""
        return torch.einsum("bk,kl,bl->b", difference, self.weighted_gram, difference).mean()

    def loss_terms(
        self,
        generated: Float[Tensor, "B K"],
        true: Float[Tensor, "B K"],
        generated_next: Float[Tensor, "B K"],
        true_next: Float[Tensor, "B K"],
    ) -> dict[str, Tensor]:
        """Eq. 8 and its two terms."""
        shape = self.masked_squared_error(true - generated)
        motion = self.masked_squared_error((true_next - true) - (generated_next - generated))
        return {
            "total": self.settings.shape_weight * shape + self.settings.motion_weight * motion,
            "shape": shape,
            "motion": motion,
        }
