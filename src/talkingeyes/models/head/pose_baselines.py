"""Head poses without a network: the mean pose, a random sequence, the nearest neighbour in speech features.

They are the baselines of Zhang et al., section 5.2. The sequences are windows of 256 true frames of the train split;
one follows the other, so poses jump where they meet, as in the paper.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction, TrainingWindows, mean_and_std


class PoseBaselineSettings(ComponentSettings):
    """Nothing but its kind."""


class MeanPose(nn.Module):
    """The mean pose, always: zeros, since poses are centred."""

    settings_class = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()

    def set_training_windows(self, training_windows: TrainingWindows) -> None:
        """It needs nothing."""

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """The mean has nothing to learn; its distances are told."""
        return _distances(torch.zeros_like(pose), pose)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Zeros."""
        return torch.zeros(len(generators), inputs.features.shape[1], 6)


class RandomPose(nn.Module):
    """Sequences of the train split, drawn alike."""

    pose: Tensor
    speech_statistics: Tensor
    settings_class = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.register_buffer("pose", torch.zeros(0, 1, 6))
        self.register_buffer("speech_statistics", torch.zeros(0, 2 * embedding))

    def set_training_windows(self, training_windows: TrainingWindows) -> None:
        """Keep the windows."""
        self.pose, self.speech_statistics = training_windows.pose, training_windows.speech_statistics

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """There is nothing to learn; distances of its draws are told."""
        generators = [torch.Generator().manual_seed(row) for row in range(len(pose))]
        return _distances(self.sample(inputs, pose[:, 0], generators), pose)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Windows end to end, the last one cut."""
        frames, length = inputs.standardised.shape[1], self.pose.shape[1]
        parts = [
            self.pose[self._select(inputs.standardised[:, first : first + length], generators)]
            for first in range(0, frames, length)
        ]
        return torch.cat(parts, dim=1)[:, :frames]

    def _select(self, standardised: Float[Tensor, "B T H"], generators: list[torch.Generator]) -> Int[Tensor, " B"]:
        return torch.cat([torch.randint(len(self.pose), (1,), generator=each) for each in generators])

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *others: object) -> None:
        """A stored memory has a size that the settings do not tell."""
        for name in ("pose", "speech_statistics"):
            setattr(self, name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *others)


class SimilarPose(RandomPose):
    """The sequence whose sound is nearest, by means and deviations of speech features over the window."""

    def _select(self, standardised: Float[Tensor, "B T H"], generators: list[torch.Generator]) -> Int[Tensor, " B"]:
        return torch.cdist(mean_and_std(standardised), self.speech_statistics).argmin(1)


def _distances(generated: Float[Tensor, "B T 6"], pose: Float[Tensor, "B T 6"]) -> PosePrediction:
    return PosePrediction(
        generated, {"pose": losses.reconstruction(generated, pose), "motion": losses.velocity(generated, pose)}
    )
