"""History of a gaze decoder in training. TalkingEyes eq. 9 prints the predicted past, and not how its gradient flows.

`free_running` runs the decoder on its own output, as at inference, with backpropagation through time. `predicted` does
so without gradient, and then predicts all frames in one parallel pass. `teacher_forcing` is the true history, which the
cited CodeTalker (Xing et al. 2023) trains on: a decoder then never sees the consequences of its own errors, and copies
the last frame (docs/log.md). `noise` adds noise to it. `scheduled_sampling` replaces a fraction of it, which grows with
training, by predictions of a first pass of the same network (Bengio et al. 2015; in parallel over all positions as in
Mihaylova & Martins 2019).
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
    """The true history."""

    kind: Literal["teacher_forcing"]


class NoisyTeacherForcing(Settings):
    """The true history with Gaussian noise, sampled per frame or code."""

    kind: Literal["noise"]
    # In standard deviations of the history: gaze of the train split, or the values of the codes.
    sigma: Annotated[float, Field(gt=0)]


class ScheduledSampling(Settings):
    """A mix of the true history and predictions of the network."""

    kind: Literal["scheduled_sampling"]
    # Final fraction of predicted frames or codes.
    max_fraction: Annotated[float, Field(gt=0, le=1)]
    # Training steps of the linear increase from 0.
    ramp_steps: Annotated[int, Field(gt=0)]


class PredictedPast(Settings):
    """The decoder's own output, without gradient through time."""

    kind: Literal["predicted"]


class FreeRunning(Settings):
    """The decoder's own output, with gradient through time. A training step costs a pass for each frame of a window."""

    kind: Literal["free_running"]
    # Truncation of backpropagation through time; null: none.
    truncation_frames: Annotated[int, Field(gt=0)] | None


# Sampled codes have no gradient, so a decoder of codes does not support `free_running`.
CodeHistorySettings = Annotated[TeacherForcing | NoisyTeacherForcing | ScheduledSampling, Field(discriminator="kind")]
HistorySettings = Annotated[
    TeacherForcing | NoisyTeacherForcing | ScheduledSampling | PredictedPast | FreeRunning, Field(discriminator="kind")
]


def replacement_mask(
    settings: ScheduledSampling, trained_steps: int, like: Float[Tensor, "B N *F"]
) -> Bool[Tensor, "B N"]:
    """Frames or codes to replace by predictions in this step."""
    uniform = torch.rand_like(like[:, :, 0] if like.dim() > 2 else like)
    return uniform < settings.max_fraction * ramp(trained_steps, settings.ramp_steps)
