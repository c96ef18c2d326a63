"""Head poses without a network: the mean pose, a random sequence, the nearest neighbour in speech features.

They are the baselines of Zhang et al., section 5.2. The sequences are windows of 256 true frames of the train split;
one follows the other, so poses jump where they meet, as in the paper.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from talkingeyes.core.settings import PartSettings
from talkingeyes.models import losses
from talkingeyes.models.head.pose import Heard, Memory, PosePrediction, described


class PoseBaselineSettings(PartSettings):
    """Nothing but its kind."""


class MeanPose(nn.Module):
    """The mean pose, always: zeros, since poses are centred."""

    configured_by = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()

    def remember(self, memory: Memory) -> None:
        """It needs nothing."""

    def predict(self, heard: Heard, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """The mean has nothing to learn; its distances are told."""
        return _told(torch.zeros_like(pose), pose)

    def sample(self, heard: Heard, start: Float[Tensor, "B 6"], noise: list[torch.Generator]) -> Float[Tensor, "B T 6"]:
        """Zeros."""
        return torch.zeros(len(noise), heard.features.shape[1], 6)


class RandomPose(nn.Module):
    """Sequences of the train split, drawn alike."""

    pose: Tensor
    sound: Tensor
    configured_by = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.register_buffer("pose", torch.zeros(0, 1, 6))
        self.register_buffer("sound", torch.zeros(0, 2 * embedding))

    def remember(self, memory: Memory) -> None:
        """Keep the windows."""
        self.pose, self.sound = memory.pose, memory.sound

    def predict(self, heard: Heard, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """There is nothing to learn; distances of its draws are told."""
        noise = [torch.Generator().manual_seed(row) for row in range(len(pose))]
        return _told(self.sample(heard, pose[:, 0], noise), pose)

    def sample(self, heard: Heard, start: Float[Tensor, "B 6"], noise: list[torch.Generator]) -> Float[Tensor, "B T 6"]:
        """Windows end to end, the last one cut."""
        frames, length = heard.standard.shape[1], self.pose.shape[1]
        parts = [
            self.pose[self._chosen(heard.standard[:, first : first + length], noise)]
            for first in range(0, frames, length)
        ]
        return torch.cat(parts, dim=1)[:, :frames]

    def _chosen(self, standard: Float[Tensor, "B T H"], noise: list[torch.Generator]) -> Int[Tensor, " B"]:
        return torch.cat([torch.randint(len(self.pose), (1,), generator=each) for each in noise])

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *others: object) -> None:
        """A stored memory has a size that the settings do not tell."""
        for name in ("pose", "sound"):
            setattr(self, name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *others)


class SimilarPose(RandomPose):
    """The sequence whose sound is nearest, by means and deviations of speech features over the window."""

    def _chosen(self, standard: Float[Tensor, "B T H"], noise: list[torch.Generator]) -> Int[Tensor, " B"]:
        return torch.cdist(described(standard), self.sound).argmin(1)


def _told(made: Float[Tensor, "B T 6"], pose: Float[Tensor, "B T 6"]) -> PosePrediction:
    return PosePrediction(made, {"pose": losses.reconstruction(made, pose), "motion": losses.velocity(made, pose)})
