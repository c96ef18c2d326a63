"""Fixed encoder for the Frechet distance and MMD: a small variational autoencoder of 2.56 s of head and gaze.

A window is described by steps of 0.16 s: mean angles (gaze in space, eye-in-head, head) and the logarithms of their
mean and peak speeds. An autoencoder of angles alone spends its few latent dimensions on posture and is nearly blind to
jitter, smoothing and stillness. With speeds as further targets, it has to encode them. The features are the means of
the latent code, which have unit scale where a dimension is used and are near 0 where it is not (Kingma & Welling 2014),
and two reconstruction errors, of angles and of speeds, as standardised logarithms. A code represents the variation of
real motion. Motion that never occurs in real data, such as jitter in every frame, is visible in the errors only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.kinematics import eye_speed_deg_s, gaze_in_space_speed_deg_s, head_speed_deg_s
from talkingeyes.core.rotation import gaze_in_space, gaze_to_angles
from talkingeyes.core.settings import Settings

# Yaw and pitch of gaze in space and of eye-in-head, and the head's rotation vector; mean and peak speeds follow.
ANGLE_COUNT = 2 + 2 + 3
SPEED_FLOOR_DEG_S = 1.0  # lower speeds are tracker noise


class MotionAutoencoderSettings(Settings):
    """Size of the autoencoder."""

    step_frames: Annotated[int, Field(gt=0)]
    width: Annotated[int, Field(gt=0)]
    latent: Annotated[int, Field(gt=0, le=14)]  # a Gaussian of more dimensions needs larger corpora
    kl_weight: Annotated[float, Field(gt=0)]  # weight of the KL term in eq. 10 of Kingma & Welling


def window_features(
    head: Float[ndarray, "B T 3"], gaze: Float[ndarray, "B T 2 3"], fps: float, step_frames: int
) -> Float[ndarray, "B N 13"]:
    """Steps of windows: mean angles (degrees) and logarithms of mean and peak speed (degrees per second)."""
    poses = [gaze_in_space(head, gaze).mean(axis=-2), gaze_to_angles(gaze).mean(axis=-2), head]
    speeds = [gaze_in_space_speed_deg_s(head, gaze, fps), eye_speed_deg_s(gaze, fps), head_speed_deg_s(head, fps)]
    pose = _steps(np.degrees(np.concatenate(poses, axis=-1)), step_frames)
    speed_steps = _steps(np.pad(np.stack(speeds, axis=-1), ((0, 0), (1, 0), (0, 0)), mode="edge"), step_frames)
    return np.concatenate(
        [
            pose.mean(axis=2),
            np.log(speed_steps.mean(axis=2) + SPEED_FLOOR_DEG_S),
            np.log(speed_steps.max(axis=2) + SPEED_FLOOR_DEG_S),
        ],
        axis=-1,
    )


def _steps(frames: Float[ndarray, "B T C"], step_frames: int) -> Float[ndarray, "B N L C"]:
    count = frames.shape[1] // step_frames
    return frames[:, : count * step_frames].reshape(len(frames), count, step_frames, -1)


@dataclass(frozen=True)
class Reconstruction:
    """Reconstructed standardised steps, and the KL divergence of the code from its prior (nats per window)."""

    steps: Float[Tensor, "B N C"]
    divergence: Float[Tensor, " B"]


class MotionAutoencoder(nn.Module):
    """MLPs over all numbers of a window as encoder and decoder."""

    mean: Tensor
    std: Tensor
    error_mean: Tensor
    error_std: Tensor

    def __init__(
        self, settings: MotionAutoencoderSettings, steps: int, mean: Float[Tensor, " C"], std: Float[Tensor, " C"]
    ) -> None:
        """`steps` per window; `mean` and `std` of the channels over the train split."""
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("std", std)
        self.register_buffer("error_mean", torch.zeros(2))
        self.register_buffer("error_std", torch.ones(2))
        self.feature_count = settings.latent + 2
        numbers, width, latent = steps * len(mean), settings.width, settings.latent
        self.encoder = nn.Sequential(
            nn.Linear(numbers, width), nn.GELU(), nn.Linear(width, width), nn.GELU(), nn.Linear(width, 2 * latent)
        )
        self.decoder = nn.Sequential(
            nn.Linear(latent, width), nn.GELU(), nn.Linear(width, width), nn.GELU(), nn.Linear(width, numbers)
        )

    def standardised(self, steps: Float[Tensor, "B N C"]) -> Float[Tensor, "B N C"]:
        """Channels of mean 0 and standard deviation 1."""
        return (steps - self.mean) / self.std

    def fit_error_statistics(self, steps: Float[Tensor, "B N C"]) -> None:
        """Set the statistics of reconstruction errors from these windows, once after training."""
        errors = self._errors(steps, self._code_mean(steps))
        self.error_mean.copy_(errors.mean(dim=0))
        self.error_std.copy_(errors.std(dim=0))

    def features(self, steps: Float[Tensor, "B N C"]) -> Float[Tensor, "B D"]:
        """Means of the code and both standardised errors."""
        mean = self._code_mean(steps)
        return torch.cat([mean, (self._errors(steps, mean) - self.error_mean) / self.error_std], dim=1)

    def _code_mean(self, steps: Float[Tensor, "B N C"]) -> Float[Tensor, "B L"]:
        code: Tensor = self.encoder(self.standardised(steps).flatten(1))
        return code.chunk(2, dim=1)[0]

    def _errors(self, steps: Float[Tensor, "B N C"], mean: Float[Tensor, "B L"]) -> Float[Tensor, "B 2"]:
        """Logarithms of the mean squared errors of angles and of speeds."""
        square = (self.decoder(mean).reshape(steps.shape) - self.standardised(steps)).square().mean(dim=1)
        return torch.stack([square[:, :ANGLE_COUNT].mean(dim=1), square[:, ANGLE_COUNT:].mean(dim=1)], dim=1).log()

    def forward(self, steps: Float[Tensor, "B N C"], noise: Float[Tensor, "B D"]) -> Reconstruction:
        """Reconstruct from a sampled code; `noise` is standard normal, or 0 for the mean."""
        mean, log_variance = self.encoder(self.standardised(steps).flatten(1)).chunk(2, dim=1)
        log_variance = log_variance.clamp(-10.0, 4.0)
        reconstructed: Tensor = self.decoder(mean + noise * torch.exp(0.5 * log_variance))
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=1)
        return Reconstruction(reconstructed.reshape(steps.shape), divergence)
