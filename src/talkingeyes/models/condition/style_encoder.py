"""How somebody moves: a style read off a clip of motion, so that speakers whom the training never saw have one too.

In training the clip is another one of the window's own speaker: what both share is the person, not what is said. The
paper names a speaker embedding as what its model lacks (section VI). What is read are statistics, few enough that a
dozen speakers do not let the encoder learn them by heart.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models.condition.conditioner import (
    ConditionFeatures,
    ConditioningInputs,
    ConditioningSpec,
    InputName,
    TrainingStatistics,
    condition_dropout_mask,
)

MOTION_DIM = 9
STATISTICS_DIM = 3 * MOTION_DIM
MAX_DEVIATION = 3.0  # deviations: nobody's style is read as stranger than that
MIN_SPREAD_RAD = 1e-4  # radians: what moves less is still


class StyleEncoderSettings(ComponentSettings):
    """The encoder of styles."""

    kind: Literal["reference"]
    # Numbers of a style.
    style_dim: Annotated[int, Field(gt=0)]
    # Share of the training windows that are given no reference.
    condition_dropout: Annotated[float, Field(ge=0, lt=1)]


class StyleEncoder(nn.Module):
    """A vector of each reference, or a learnt one where there is none."""

    mean: Tensor
    std: Tensor

    settings_class = StyleEncoderSettings
    required_inputs: tuple[InputName, ...] = ("reference",)

    def __init__(self, settings: StyleEncoderSettings, width: int, spec: ConditioningSpec) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("mean", torch.zeros(STATISTICS_DIM))
        self.register_buffer("std", torch.ones(STATISTICS_DIM))
        self.style = nn.Linear(STATISTICS_DIM, settings.style_dim)
        self.vector = nn.Linear(settings.style_dim, width)
        self.null_embedding = nn.Parameter(torch.zeros(width))

    def fit_statistics(self, statistics: TrainingStatistics) -> None:
        """In what, and by how much, the motions of the train split differ."""
        motion_features = torch.stack([motion_statistics(each[None])[0] for each in statistics.motions])
        std = motion_features.std(0, correction=0)
        self.mean.copy_(motion_features.mean(0))
        self.std.copy_(torch.where(std > MIN_SPREAD_RAD, std, torch.inf))

    def forward(self, conditioning: ConditioningInputs, batch_size: int) -> ConditionFeatures:
        """The vector of each window's reference."""
        if conditioning.reference is None:
            return ConditionFeatures.shared(self.null_embedding.expand(batch_size, 1, -1))
        missing = conditioning.reference.isnan().flatten(1).any(1)
        motion_features = (motion_statistics(conditioning.reference.nan_to_num()) - self.mean) / self.std
        motion_features = motion_features.clamp(-MAX_DEVIATION, MAX_DEVIATION)
        found = self.vector(self.style(motion_features).tanh())
        condition_dropout = missing | condition_dropout_mask(
            len(missing), self.settings.condition_dropout, self.training, missing.device
        )
        return ConditionFeatures.shared(torch.where(condition_dropout[:, None], self.null_embedding, found)[:, None])


def motion_statistics(motion: Float[Tensor, "B R 9"]) -> Float[Tensor, "B 27"]:
    """Where each number rests, and the logarithms of how far and how fast it moves."""
    wide = motion.std(1, correction=0).clamp(min=MIN_SPREAD_RAD).log()
    fast = motion.diff(dim=1).abs().mean(1).clamp(min=MIN_SPREAD_RAD / 10).log()
    return torch.cat([motion.mean(1), wide, fast], dim=1)
