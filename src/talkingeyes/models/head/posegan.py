"""PoseGAN: head poses by a convolutional encoder and a U-Net, from speech and an initial pose (Zhang et al., 4.1).

The initial pose is concatenated with the speech at the input, and projected onto the output. The losses are eq. 3: pose
(with the distance of the first frame from the initial pose) and motion. The adversarial loss (eq. 4 and 5, missing from
the text that we have) comes from the discriminator (discriminator.py). Windows have 256 frames. In longer speech, the
last pose of a window is the initial pose of the next (models/speech_to_pose.py).

Our additions: the style scales and shifts the normalised features of the U-Net (Perez et al. 2018) and scales the pose.
Added to speech alone, the style does not survive the normalisation, and all speakers move alike (docs/log.md). The
distance of the first frame from the initial pose is removed over `anchor_frames` (0: as in the paper).
"""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction
from talkingeyes.models.layers.convolution import ConvolutionStack

GROUPS = 8


class PoseGANSettings(ComponentSettings):
    """Size of the generator."""

    width: Annotated[int, Field(gt=0, multiple_of=GROUPS)]
    # Dilated convolutions of the encoder before the U-Net.
    layers: Annotated[int, Field(ge=0)]
    # Halvings of the frame rate in the U-Net: 5 reduce 256 frames to 8.
    levels: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    # Frames of a window (the paper: 256).
    window: Annotated[int, Field(gt=1)]
    # Whether the initial pose is an input (in the ablation it is not).
    initial_pose: bool
    # Frames over which the distance of the first frame from the initial pose is removed; 0: never.
    anchor_frames: Annotated[int, Field(ge=0)]


class PoseGAN(nn.Module):
    """The generator G(x, p)."""

    settings_class = PoseGANSettings

    def __init__(self, settings: PoseGANSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.settings = settings
        self.window = settings.window
        width = settings.width
        self.encoder = ConvolutionStack(speech + 6, width, settings.layers, settings.dropout)
        self.down = nn.ModuleList(_DownBlock(width, speech) for _ in range(settings.levels))
        self.up = nn.ModuleList(_UpBlock(width, speech) for _ in range(settings.levels))
        self.out = nn.Linear(width, 6)
        self.gain = nn.Linear(speech, 6)
        self.pose_projection = nn.Linear(6, 6)

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Losses of eq. 3, with the first true frame as the initial pose."""
        generated = self(inputs, pose[:, 0])
        loss_terms = {
            "pose": losses.reconstruction(generated, pose),
            "initial_pose": losses.reconstruction(generated[:, :1], pose[:, :1]),
            "motion": losses.velocity(generated, pose),
        }
        return PosePrediction(generated, loss_terms)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Poses of one window, corrected to start at the initial pose."""
        generated: Tensor = self(inputs, start)
        if not self.settings.anchor_frames or not self.settings.initial_pose:
            return generated
        fading = 1 - torch.arange(generated.shape[1], device=generated.device) / self.settings.anchor_frames
        anchored: Tensor = generated + fading.clamp(min=0)[:, None] * (start - generated[:, 0])[:, None]
        return anchored

    def forward(self, inputs: PoseInputs, start: Float[Tensor, "B 6"]) -> Float[Tensor, "B T 6"]:
        """Poses of one window."""
        frames = inputs.features.shape[1]
        if not self.settings.initial_pose:
            start = torch.zeros_like(start)
        entered = torch.cat([inputs.features, start[:, None].expand(-1, frames, -1)], dim=-1)
        h = self._padded(self.encoder(entered)).transpose(1, 2)
        kept = []
        for down_block in self.down:
            kept.append(h)
            h = down_block(h, inputs.style)
        for up_block in self.up:
            h = up_block(h, inputs.style) + kept.pop()
        last = h.transpose(1, 2)[:, :frames]
        generated: Tensor = (
            self.out(last) * self.gain(inputs.style).exp()[:, None] + self.pose_projection(start)[:, None]
        )
        return generated

    def _padded(self, features: Float[Tensor, "B T W"]) -> Float[Tensor, "B U W"]:
        """Pad to a multiple of the U-Net's total stride by repeating the last frame."""
        missing = -features.shape[1] % 2**self.settings.levels
        return torch.cat([features, features[:, -1:].expand(-1, missing, -1)], dim=1)


class _DownBlock(nn.Module):
    """Halve the frame rate."""

    def __init__(self, width: int, style: int) -> None:
        super().__init__()
        self.convolution = nn.Conv1d(width, width, 4, stride=2, padding=1)
        self.norm = _AdaptiveGroupNorm(width, style)

    def forward(self, h: Float[Tensor, "B W T"], style: Float[Tensor, "B S"]) -> Float[Tensor, "B W U"]:
        return functional.leaky_relu(self.norm(self.convolution(h), style), 0.2)


class _UpBlock(nn.Module):
    """Double the frame rate by linear interpolation; repeated frames would cause steps."""

    def __init__(self, width: int, style: int) -> None:
        super().__init__()
        self.convolution = nn.Conv1d(width, width, 3, padding=1)
        self.norm = _AdaptiveGroupNorm(width, style)

    def forward(self, h: Float[Tensor, "B W T"], style: Float[Tensor, "B S"]) -> Float[Tensor, "B W U"]:
        twice = functional.interpolate(h, scale_factor=2.0, mode="linear")
        return functional.leaky_relu(self.norm(self.convolution(twice), style), 0.2)


class _AdaptiveGroupNorm(nn.Module):
    """Group normalisation scaled and shifted by the style."""

    def __init__(self, width: int, style: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, width, affine=False)
        self.style_projection = nn.Linear(style, 2 * width)

    def forward(self, h: Float[Tensor, "B W T"], style: Float[Tensor, "B S"]) -> Float[Tensor, "B W T"]:
        scale, shift = self.style_projection(style)[..., None].chunk(2, dim=1)
        styled: Tensor = self.norm(h) * (1 + scale) + shift
        return styled
