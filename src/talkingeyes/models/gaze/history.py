"""What a gaze decoder is shown of the past while it is trained: against the mismatch between true and own past.

Trained on true history alone (teacher forcing, TalkingEyes eq. 9), a decoder never sees what its own errors lead to and
copies the last frame (docs/log.md). `noise` blurs the true history; `scheduled_sampling` replaces a share of it, which
grows with training, by what a first pass of the same network predicts there (Bengio et al. 2015; in parallel over all
positions as in Mihaylova & Martins 2019); `free_running` lets the decoder run as in use, on nothing but its own output,
with the gradient going back through so many frames of it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from talkingeyes.core.settings import Settings
from talkingeyes.models.layers.schedules import ramp


class TeacherForcing(Settings):
    """The true past, as the paper has it."""

    kind: Literal["teacher_forcing"]


class NoisyTeacherForcing(Settings):
    """The true past with Gaussian noise on it, drawn for each frame or code."""

    kind: Literal["noise"]
    # In standard deviations of what the history is made of: gaze of the train split, or the values of the codes.
    sigma: Annotated[float, Field(gt=0)]


class ScheduledSampling(Settings):
    """A mix of the true past and what the network predicts of it."""

    kind: Literal["scheduled_sampling"]
    # Share of frames or codes that are predicted, once it has grown to this.
    max_fraction: Annotated[float, Field(gt=0, le=1)]
    # Steps of training along which it grows from 0.
    ramp_steps: Annotated[int, Field(gt=0)]


class FreeRunning(Settings):
    """The decoder's own output, frame by frame. A step of training costs as many passes as a window has frames."""

    kind: Literal["free_running"]
    # The gradient goes back through so many frames at most.
    truncation_frames: Annotated[int, Field(gt=0)]


# A decoder that draws codes has no gradient to its own output, and can do without `free_running`.
CodeHistorySettings = Annotated[TeacherForcing | NoisyTeacherForcing | ScheduledSampling, Field(discriminator="kind")]
HistorySettings = Annotated[
    TeacherForcing | NoisyTeacherForcing | ScheduledSampling | FreeRunning, Field(discriminator="kind")
]


def replacement_mask(
    settings: ScheduledSampling, trained_steps: int, like: Float[Tensor, "B N *F"]
) -> Bool[Tensor, "B N"]:
    """Which frames or codes are the network's own in this step."""
    drawn = torch.rand_like(like[:, :, 0] if like.dim() > 2 else like)
    return drawn < settings.max_fraction * ramp(trained_steps, settings.ramp_steps)
