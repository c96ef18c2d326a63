"""Contrastive audio-motion critic behind Corr. (section V-B.3): does this motion belong to this sound?

Two convolutional towers at 6.25 Hz, one for the speech embedding and one for motion, each output a feature vector per
step. The similarity of a window is the cosine between the concatenated features of its steps, so sound and motion must
agree in time. A network that pools a window to one vector learns the identity of the speaker instead (docs/log.md). For
the same reason, the window's median is subtracted from motion and its mean from speech (otherwise a toy coupling
learned from nine speakers did not generalise to three unseen ones: AUC 0.65 instead of 1.0), and negatives come from
the same speaker (evaluation/measures/critic.py).

The paper says only that features of a binary classifier are compared by their cosine. Our departures: features aligned
in time, one network per part, and for the eyes both eye-in-head (as in the paper; largely driven by the head through
counter-rotation) and gaze in space.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.rotation import gaze_in_space
from talkingeyes.core.settings import Settings

CRITIC_PARTS = ("eyes", "gaze_in_space", "head")
# Signs by which mirroring multiplies the angles of each part.
MIRROR_SIGNS = {"eyes": (1.0, -1.0), "gaze_in_space": (-1.0, 1.0), "head": (1.0, -1.0, -1.0)}


class CriticNetworkSettings(Settings):
    """Size of both towers."""

    step_frames: Annotated[int, Field(gt=0)]  # motion frames per step: 4 at 25 fps is 6.25 Hz
    width: Annotated[int, Field(gt=0)]
    layers: Annotated[int, Field(gt=0)]
    kernel: Annotated[int, Field(gt=0)]  # steps, odd
    features: Annotated[int, Field(gt=0)]  # per step
    dropout: Annotated[float, Field(ge=0, lt=1)]


def part_angles(
    part: str, head: Float[ndarray, "*S T 3"], gaze: Float[ndarray, "*S T 2 3"]
) -> Float[ndarray, "*S T A"]:
    """Input angles (radians) of the critic of a part; for the eyes their mean, because they are conjugate."""
    if part == "head":
        return head
    if part == "eyes":
        return np.asarray(gaze[..., :2].mean(axis=-2))
    return np.asarray(gaze_in_space(head, gaze).mean(axis=-2))


class Tower(nn.Module):
    """From steps to features: a projection, then residual convolutions over time."""

    def __init__(self, channels: int, settings: CriticNetworkSettings) -> None:
        super().__init__()
        width, kernel = settings.width, settings.kernel
        self.input_projection = nn.Conv1d(channels, width, 1)
        self.layers = nn.ModuleList(nn.Conv1d(width, width, kernel, padding="same") for _ in range(settings.layers))
        self.dropout = nn.Dropout(settings.dropout)
        self.output_projection = nn.Conv1d(width, settings.features, 1)

    def forward(self, steps: Float[Tensor, "B N C"]) -> Float[Tensor, "B N F"]:
        hidden = self.input_projection(self.dropout(steps.transpose(1, 2)))
        for layer in self.layers:
            hidden = hidden + functional.gelu(layer(self.dropout(hidden)))
        features: Tensor = self.output_projection(self.dropout(hidden))
        return features.transpose(1, 2)


class Critic(nn.Module):
    """Both towers, with the statistics that standardise their inputs."""

    speech_channels: Tensor
    speech_mean: Tensor
    speech_std: Tensor
    motion_scale: Tensor

    def __init__(
        self,
        settings: CriticNetworkSettings,
        speech_channels: Int[Tensor, " H"],
        speech_mean: Float[Tensor, " H"],
        speech_std: Float[Tensor, " H"],
        motion_scale: Float[Tensor, 2],
        motion_angles: int,
    ) -> None:
        """`speech_channels`: the input channels of the embedding, with their statistics.

        `motion_scale`: one scale for all angles (radians) and one for their speed (radians per frame).
        """
        super().__init__()
        self.step_frames = settings.step_frames
        self.register_buffer("speech_channels", speech_channels)
        self.register_buffer("speech_mean", speech_mean)
        self.register_buffer("speech_std", speech_std)
        self.register_buffer("motion_scale", motion_scale)
        self.speech_tower = Tower(len(speech_mean), settings)
        self.motion_tower = Tower(motion_angles + 3, settings)
        self.log_scale = nn.Parameter(torch.zeros(()))  # temperature of InfoNCE, not used by Corr.

    def speech(self, speech_features: Float[Tensor, "B T H"]) -> Float[Tensor, "B N F"]:
        """Features of windows of the input channels. The mean over the window is subtracted, because it identifies the
        speaker."""
        standard = (self._steps(speech_features).mean(dim=2) - self.speech_mean) / self.speech_std
        features: Tensor = self.speech_tower(standard - standard.mean(dim=1, keepdim=True))
        return features

    def motion(self, angles: Float[Tensor, "B T A"]) -> Float[Tensor, "B N F"]:
        """Features of windows of motion: angles relative to their median, the norm of these, mean and peak speed."""
        centred = angles - angles.median(dim=1, keepdim=True).values
        speed = functional.pad(angles.diff(dim=1).norm(dim=-1), (1, 0))
        pose = self._steps(centred).mean(dim=2) / self.motion_scale[0]
        speed_steps = self._steps(speed[..., None] / self.motion_scale[1])
        away = pose.norm(dim=-1, keepdim=True)
        channels = [pose, away, torch.log1p(speed_steps.mean(dim=2)), torch.log1p(speed_steps.amax(dim=2))]
        features: Tensor = self.motion_tower(torch.cat(channels, dim=-1))
        return features

    def _steps(self, frames: Float[Tensor, "B T C"]) -> Float[Tensor, "B N L C"]:
        count = frames.shape[1] // self.step_frames
        return frames[:, : count * self.step_frames].reshape(len(frames), count, self.step_frames, -1)


def similarity(one: Float[Tensor, "B N F"], other: Float[Tensor, "D N F"]) -> Float[Tensor, "B D"]:
    """Cosine between the features of all steps, for all pairs of windows."""
    return functional.normalize(one.flatten(1), dim=1) @ functional.normalize(other.flatten(1), dim=1).T
