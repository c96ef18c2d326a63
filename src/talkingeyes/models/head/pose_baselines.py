"""Head poses without a network: the mean pose, a random sequence, the nearest neighbour in speech features.

These are the baselines of Zhang et al., section 5.2. The sequences are windows of 256 true frames of the train split.
They are concatenated, so poses jump at the joins, as in the paper.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from talkingeyes.core.settings import ComponentSettings
from talkingeyes.models import losses
from talkingeyes.models.baselines import nearest_sounds
from talkingeyes.models.head.pose_generator import PoseInputs, PosePrediction


class PoseBaselineSettings(ComponentSettings):
    """Settings of the baselines: the kind alone."""


class MeanPose(nn.Module):
    """Constant mean pose: zeros, because poses are centred."""

    settings_class = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Distances of the mean from true poses; there are no parameters to train."""
        return _distances(torch.zeros_like(pose), pose)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Zeros of shape (B, T, 6)."""
        return torch.zeros(len(generators), inputs.features.shape[1], 6)


class RandomPose(nn.Module):
    """Uniformly sampled sequences of the train split."""

    pose: Tensor
    speech_features: Tensor
    settings_class = PoseBaselineSettings
    window = None

    def __init__(self, settings: PoseBaselineSettings, speech: int, embedding: int) -> None:
        super().__init__()
        self.register_buffer("pose", torch.zeros(0, 1, 6))
        self.register_buffer("speech_features", torch.zeros(0, 2 * embedding))

    def set_training_windows(self, pose: Float[Tensor, "N L 6"], speech_features: Float[Tensor, "N D"]) -> None:
        """Store the windows and the means and deviations of their speech."""
        self.pose, self.speech_features = pose, speech_features

    def predict(self, inputs: PoseInputs, pose: Float[Tensor, "B T 6"]) -> PosePrediction:
        """Distances of random sequences from true poses; there are no parameters to train."""
        generators = [torch.Generator().manual_seed(row) for row in range(len(pose))]
        return _distances(self.sample(inputs, pose[:, 0], generators), pose)

    def sample(
        self, inputs: PoseInputs, start: Float[Tensor, "B 6"], generators: list[torch.Generator]
    ) -> Float[Tensor, "B T 6"]:
        """Concatenated windows, the last one cut."""
        frames, length = inputs.standardised.shape[1], self.pose.shape[1]
        parts = [
            self.pose[self._select(inputs.standardised[:, first : first + length], generators)]
            for first in range(0, frames, length)
        ]
        return torch.cat(parts, dim=1)[:, :frames]

    def _select(self, standardised: Float[Tensor, "B T H"], generators: list[torch.Generator]) -> Int[Tensor, " B"]:
        return torch.cat([torch.randint(len(self.pose), (1,), generator=each) for each in generators])

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *others: object) -> None:
        """Resize the buffers first: the size of the stored windows is not part of the settings."""
        for name in ("pose", "speech_features"):
            setattr(self, name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *others)


class SimilarPose(RandomPose):
    """The sequence with the nearest speech, by the features that Similar Sample of TalkingEyes compares."""

    def _select(self, standardised: Float[Tensor, "B T H"], generators: list[torch.Generator]) -> Int[Tensor, " B"]:
        features = self.speech_features.numpy(force=True)
        return torch.tensor([nearest_sounds(features, each.numpy(force=True), 1)[0] for each in standardised])


def _distances(generated: Float[Tensor, "B T 6"], pose: Float[Tensor, "B T 6"]) -> PosePrediction:
    return PosePrediction(
        generated, {"pose": losses.reconstruction(generated, pose), "motion": losses.velocity(generated, pose)}
    )
