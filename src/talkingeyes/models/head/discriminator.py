"""Discriminator of PoseGAN (Zhang et al., section 4.1).

It scores motion on overlapping parts of a window. Motion is the difference over one frame and over half a second.
Without the second lag, the discriminator would not miss the slow turns that make up most of a head's range. What else
it sees, c, is a setting: the paper asks whether the motion "belongs to the specific character" (`speaker`) and that it
correlate with the sound (`pose` and `speech`). With neither, it is the discriminator of motion alone of Ginosar et al.
2019. The speaker enters by the product of its vector with the features (Miyato & Koyama 2018), pose and speech frame by
frame at the input. Eq. 4 and 5 are missing from the text that we have. We assume, after Ginosar et al.:

    discriminator   minimise  -log D(motion of y, c) - log(1 - D(motion of G, c))     mean over parts
    generator       minimise  lambda * -log D(motion of G, c)                         sum over parts

The generator's loss is a sum over the parts of a window, so that with the paper's lambda of 0.01 it has enough weight
beside losses that are means over frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.settings import Settings

LAGS_FRAMES = (1, 15)


class DiscriminatorSettings(Settings):
    """Size and inputs of the discriminator. It uses the learning rate of the generator."""

    width: Annotated[int, Field(gt=0)]
    # Strided convolutions of kernel 5: 4 layers give parts of 61 frames, every 16 frames.
    layers: Annotated[int, Field(gt=0)]
    # What it sees beside the motion.
    conditions: tuple[Literal["speaker", "pose", "speech"], ...]


@dataclass(frozen=True)
class DiscriminatorContext:
    """What a discriminator may see beside the motion: styles of the speakers, and the standardised embedding."""

    style: Float[Tensor, "B K"]
    speech: Float[Tensor, "B T C"]


class Discriminator(nn.Module):
    """Scores parts of a motion. `scale` holds the standard deviations of the differences, by lag and dimension."""

    scale: Tensor

    def __init__(self, settings: DiscriminatorSettings, speakers: int, channels: int) -> None:
        super().__init__()
        self.settings = settings
        conditions = settings.conditions
        self.register_buffer("scale", torch.ones(len(LAGS_FRAMES), 6))
        entering = 6 * len(LAGS_FRAMES) + 6 * ("pose" in conditions) + settings.width * ("speech" in conditions)
        sizes = [entering] + [settings.width] * settings.layers
        self.convolutions = nn.ModuleList(
            nn.Conv1d(taken, given, 5, stride=2, padding=2) for taken, given in pairwise(sizes)
        )
        self.score = nn.Linear(settings.width, 1)
        if "speaker" in conditions:
            self.style_projection = nn.Linear(speakers, settings.width, bias=False)
        if "speech" in conditions:
            self.speech_projection = nn.Linear(channels, settings.width)

    def forward(self, pose: Float[Tensor, "B T 6"], context: DiscriminatorContext) -> Float[Tensor, "B P"]:
        """Logits, one per part; above 0 means real."""
        seen = [motion / scale for motion, scale in zip(lagged_differences(pose), self.scale, strict=True)]
        if "pose" in self.settings.conditions:
            seen.append(pose)
        if "speech" in self.settings.conditions:
            seen.append(self.speech_projection(context.speech))
        h = torch.cat(seen, dim=-1).transpose(1, 2)
        for convolution in self.convolutions:
            h = functional.leaky_relu(convolution(h), 0.2)
        h = h.transpose(1, 2)
        scores: Tensor = self.score(h)[..., 0]
        if "speaker" in self.settings.conditions:
            scores = scores + (h * self.style_projection(context.style)[:, None]).sum(-1)
        return scores

    def generator_loss(self, generated: Float[Tensor, "B T 6"], context: DiscriminatorContext) -> Float[Tensor, ""]:
        """Adversarial loss of the generator."""
        return functional.softplus(-self(generated, context)).sum(-1).mean()

    def loss_terms(
        self, true: Float[Tensor, "B T 6"], generated: Float[Tensor, "B T 6"], context: DiscriminatorContext
    ) -> dict[str, Tensor]:
        """Loss of the discriminator, and the mean probabilities that it assigns to real and to generated motion."""
        of_true, of_made = self(true, context), self(generated, context)
        return {
            "total": functional.softplus(-of_true).mean() + functional.softplus(of_made).mean(),
            "real_probability": of_true.sigmoid().mean(),
            "fake_probability": of_made.sigmoid().mean(),
        }


def lagged_differences(pose: Float[Tensor, "B T 6"]) -> list[Float[Tensor, "B T 6"]]:
    """Differences over each lag. The first frames use the difference from frame 0."""
    first = pose[:, :1]
    before = [torch.cat([first.expand(-1, min(lag, pose.shape[1]), -1), pose], dim=1) for lag in LAGS_FRAMES]
    return [pose - each[:, : pose.shape[1]] for each in before]
