"""Head motion as movement segments: a point process of speed minima, with cubics between its events.

Not in the paper. The head of a speaker never rests, but its speed has several minima per second (detected as in
evaluation/detectors/head_movements.py). Poses at these minima, joined by cubics that slow down there, reconstruct
fitted motion within 0.4 degrees per axis and with its spectrum (docs/log.md). An event (models/layers/point_process.py)
is a speed minimum, given by its time and its pose.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field, model_validator
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings, bounds_error
from talkingeyes.models.head.generator import HeadPrediction
from talkingeyes.models.head.pose_interpolation import EXTRA_BINS, interpolate_poses
from talkingeyes.models.layers.equaliser import Equaliser
from talkingeyes.models.layers.normaliser import MotionNormaliser
from talkingeyes.models.layers.point_process import EventSequence, PointProcess, PointProcessSettings, bin_means
from talkingeyes.models.layers.point_process_sampler import sample_events

POSE_SPREAD = (1.0, 1.0, 0.6)


class PointProcessHeadSettings(ComponentSettings):
    """Settings of the point process and of its sampling."""

    kind: Literal["point_process"]
    # Sampling temperature of the mixture component and of the Gaussians; 1: as learned. Chosen on val by the benchmark.
    temperature: Annotated[float, Field(ge=0)]
    # Length of the filter that matches the spectrum of sampled heads to that of true heads (layers/equaliser.py); odd,
    # or 0 for none.
    equaliser_frames: Annotated[int, Field(ge=0)]
    process: PointProcessSettings

    @model_validator(mode="after")
    def _check_odd(self) -> PointProcessHeadSettings:
        if self.equaliser_frames and self.equaliser_frames % 2 == 0:
            raise bounds_error("equaliser_frames should be odd, or 0", self.equaliser_frames)
        return self


class PointProcessHead(nn.Module):
    """Generator of head rotation vectors from speech features."""

    settings_class = PointProcessHeadSettings

    def __init__(self, settings: PointProcessHeadSettings, speech: int) -> None:
        super().__init__()
        self.normal = MotionNormaliser(3)
        self.bin_frames, self.temperature = settings.process.bin_frames, settings.temperature
        self.process = PointProcess(settings.process, speech, POSE_SPREAD)
        self.equaliser = Equaliser(settings.equaliser_frames)

    def predict(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> HeadPrediction:
        """Likelihood of the segments of true motion. Nothing is reconstructed: gaze is trained on the true head."""
        loss_terms = self.process.loss_terms(self._events(head), bin_means(speech, self.bin_frames))
        return HeadPrediction(head, {f"head_{name}": value for name, value in loss_terms.items()})

    def log_likelihood(self, speech: Float[Tensor, "B T S"], head: Float[Tensor, "B T 3"]) -> dict[str, Tensor]:
        """Log-likelihood of the speed minima of true motion: when they are (`time`), and the pose there."""
        return self.process.log_likelihood(self._events(head), bin_means(speech, self.bin_frames))

    def _events(self, head: Float[Tensor, "B T 3"]) -> EventSequence:
        return EventSequence.from_frames(speed_minima(head), self.normal(head), self.bin_frames)

    @torch.no_grad()
    def sample(self, speech: Float[Tensor, "B T S"], seeds: list[int]) -> Float[Tensor, "B T 3"]:
        """Sample events bin by bin and interpolate them to frames."""
        unique_speech = speech[:1] if speech.stride(0) == 0 else speech  # encode one speech once for all seeds
        binned_speech = bin_means(unique_speech, self.bin_frames, EXTRA_BINS)
        count, numbers = binned_speech.shape[1], len(POSE_SPREAD) + 3
        uniform = torch.stack(
            [torch.rand(count, numbers, generator=torch.Generator().manual_seed(seed)) for seed in seeds]
        )
        sampled = sample_events(self.process, binned_speech, uniform.to(binned_speech), self.temperature)
        generated = self.equaliser(interpolate_poses(sampled.event, sampled.location, self.bin_frames))[
            :, : speech.shape[1]
        ]
        return self.normal.denormalise(torch.from_numpy(generated.astype(np.float32)).to(binned_speech))


def speed_minima(head: Float[Tensor, "B T 3"]) -> Bool[Tensor, "B T"]:
    """Frames where the head turns more slowly than in the frame before and no faster than in the frame after."""
    speed = head.diff(dim=1).norm(dim=-1)
    lower = (speed[:, 1:-1] < speed[:, :-2]) & (speed[:, 1:-1] <= speed[:, 2:])
    return torch.nn.functional.pad(lower, (1, head.shape[1] - 1 - lower.shape[1]))
