"""The discriminator of PoseGAN: does this person's head move like that? (Zhang et al., section 4.1.)

It judges motion on overlapping parts of a window, given the speaker: a score for motion alone plus its product with the
speaker's vector (Miyato & Koyama 2018). Motion is what changes in a frame, and in half a second: by the first alone it
would not miss the slow turns that most of a head's range is made of. Eq. 4 and 5 are missing from the text that we
have; assumed after Ginosar et al. 2019:

    rival       minimise  -log D(motion of y, s) - log(1 - D(motion of G, s))     mean over parts
    generator   minimise  lambda * -log D(motion of G, s)                         sum over parts

As a sum over the parts of a window it weighs, with the paper's lambda of 0.01, enough against means over frames.
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
    """Its size. It learns at the pace of the generator."""

    width: Annotated[int, Field(gt=0)]
    # Strided convolutions of kernel 5: 4 judge parts of 61 frames, every 16 frames.
    layers: Annotated[int, Field(gt=0)]


class Discriminator(nn.Module):
    """Scores of parts of motions; `scale` are the deviations of motion, by lag and number."""

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
        """Scores, above 0 for what seems true."""
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
        """What the generator minimises."""
        return functional.softplus(-self(generated, style)).sum(-1).mean()

    def loss_terms(
        self, true: Float[Tensor, "B T 6"], generated: Float[Tensor, "B T 6"], style: Float[Tensor, "B K"]
    ) -> dict[str, Tensor]:
        """What the rival minimises, and how it stands: the chance that it gives to true and to made motion."""
        of_true, of_made = self(true, style), self(generated, style)
        return {
            "total": functional.softplus(-of_true).mean() + functional.softplus(of_made).mean(),
            "real_probability": of_true.sigmoid().mean(),
            "fake_probability": of_made.sigmoid().mean(),
        }


def lagged_differences(pose: Float[Tensor, "B T 6"]) -> list[Float[Tensor, "B T 6"]]:
    """What changes over each lag; until there is one, since the first frame."""
    first = pose[:, :1]
    before = [torch.cat([first.expand(-1, min(lag, pose.shape[1]), -1), pose], dim=1) for lag in LAGS_FRAMES]
    return [pose - each[:, : pose.shape[1]] for each in before]
