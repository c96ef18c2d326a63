"""Discriminator of PoseGAN, conditioned on the speaker (Zhang et al., section 4.1).

It scores motion on overlapping parts of a window: a score of the motion alone plus its product with the speaker vector
(Miyato & Koyama 2018). Motion is the difference over one frame and over half a second. Without the second lag, the
discriminator would not miss the slow turns that make up most of a head's range. Eq. 4 and 5 are missing from the text
that we have. We assume, after Ginosar et al. 2019:

    discriminator   minimise  -log D(motion of y, s) - log(1 - D(motion of G, s))     mean over parts
    generator       minimise  lambda * -log D(motion of G, s)                         sum over parts

The generator's loss is a sum over the parts of a window, so that with the paper's lambda of 0.01 it has enough weight
beside losses that are means over frames.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from talkingeyes.core.settings import Settings

LAGS_FRAMES = (1, 15)


class DiscriminatorSettings(Settings):
    """Size of the discriminator. It uses the learning rate of the generator."""

    width: Annotated[int, Field(gt=0)]
    # Strided convolutions of kernel 5: 4 layers give parts of 61 frames, every 16 frames.
    layers: Annotated[int, Field(gt=0)]


class Discriminator(nn.Module):
    """Scores parts of a motion. `scale` holds the standard deviations of the differences, by lag and dimension."""

    scale: Tensor

    def __init__(self, settings: DiscriminatorSettings, style_dim: int) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("scale", torch.ones(len(LAGS_FRAMES), 6))
        sizes = [6 * len(LAGS_FRAMES)] + [settings.width] * settings.layers
        self.convolutions = nn.ModuleList(
            nn.Conv1d(taken, given, 5, stride=2, padding=2) for taken, given in pairwise(sizes)
        )
        self.score = nn.Linear(settings.width, 1)
        self.style_projection = nn.Linear(style_dim, settings.width, bias=False)

    def forward(self, pose: Float[Tensor, "B T 6"], style: Float[Tensor, "B K"]) -> Float[Tensor, "B P"]:
        """Logits, one per part; above 0 means real."""
        h = torch.cat(
            [motion / scale for motion, scale in zip(lagged_differences(pose), self.scale, strict=True)], dim=-1
        )
        h = h.transpose(1, 2)
        for convolution in self.convolutions:
            h = functional.leaky_relu(convolution(h), 0.2)
        h = h.transpose(1, 2)
        scores: Tensor = self.score(h)[..., 0] + (h * self.style_projection(style)[:, None]).sum(-1)
        return scores

    def generator_loss(self, generated: Float[Tensor, "B T 6"], style: Float[Tensor, "B K"]) -> Float[Tensor, ""]:
        """Adversarial loss of the generator."""
        return functional.softplus(-self(generated, style)).sum(-1).mean()

    def loss_terms(
        self, true: Float[Tensor, "B T 6"], generated: Float[Tensor, "B T 6"], style: Float[Tensor, "B K"]
    ) -> dict[str, Tensor]:
        """Loss of the discriminator, and the mean probabilities that it assigns to real and to generated motion."""
        of_true, of_made = self(true, style), self(generated, style)
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
