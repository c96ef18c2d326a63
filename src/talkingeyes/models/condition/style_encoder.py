"""Style encoder: conditioning on a reference clip of motion, so that unseen speakers have a style too.

In training, the reference is another clip of the window's speaker, so that it shares the speaker but not the speech.
The paper names a missing speaker embedding as a limitation (section VI). The encoder sees only summary statistics, few
enough that it cannot memorise a dozen speakers.
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
MAX_DEVIATION = 3.0  # in standard deviations: bound on standardised statistics
MIN_SPREAD_RAD = 1e-4  # lower bound on the spread of a motion


class StyleEncoderSettings(ComponentSettings):
    """Settings of the style encoder."""

    kind: Literal["reference"]
    # Dimensions of a style.
    style_dim: Annotated[int, Field(gt=0)]
    # Fraction of the training windows without a reference.
    condition_dropout: Annotated[float, Field(ge=0, lt=1)]


class StyleEncoder(nn.Module):
    """A vector per reference; a learned vector where there is none."""

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
        """Set mean and standard deviation of the motion statistics over the train split; constant statistics are
        ignored."""
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
    """Per dimension: mean, log standard deviation and log mean absolute change per frame."""
    wide = motion.std(1, correction=0).clamp(min=MIN_SPREAD_RAD).log()
    fast = motion.diff(dim=1).abs().mean(1).clamp(min=MIN_SPREAD_RAD / 10).log()
    return torch.cat([motion.mean(1), wide, fast], dim=1)
