"""Corr. (section V-B.3): the cosine of the critic's features of sound and motion over windows of 8 s; the critic's AUC.

Higher is not better: a conditional mean is more predictable than true motion, and a constant can score above a random
sample. Corr. is therefore read as a difference from the Corr. of the truth, next to shuffled truth and a constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from talkingeyes.core.settings import validate_section
from talkingeyes.models.contrastive_critic import MIRROR_SIGNS, Critic, CriticNetworkSettings, part_angles
from talkingeyes.training.checkpoint import load


def auc(positives: Float[ndarray, " P"], negatives: Float[ndarray, " N"]) -> float:
    """Area under the ROC curve: probability that a positive scores above a negative; ties count half."""
    ordered = np.sort(negatives)
    below, not_above = (np.searchsorted(ordered, positives, side=side) for side in ("left", "right"))
    return float((below + not_above).mean() / 2 / len(ordered))


class CriticCorrelation:
    """Corr. of one part, computed with a frozen critic."""

    def __init__(self, part: str, critic: Critic, frames: int, hop: int) -> None:
        """Use windows of `frames` frames, one every `hop` frames."""
        self.part, self.critic, self.frames, self.hop = part, critic.eval(), frames, hop

    @classmethod
    def load(cls, folder: Path, part: str) -> CriticCorrelation:
        """Load the critic of a part from the output folder of the stage `critic`."""
        checkpoint = load(folder / part)
        tensors, config = checkpoint.tensors, checkpoint.config
        critic = Critic(
            validate_section("critic.network", CriticNetworkSettings, config["network"]),
            tensors["speech_channels"],
            tensors["speech_mean"],
            tensors["speech_std"],
            tensors["motion_scale"],
            len(MIRROR_SIGNS[part]),
        )
        critic.load_state_dict(tensors)
        return cls(part, critic, int(config["frames"]), int(config["hop"]))

    def __call__(
        self, speech: Float[ndarray, "T C"], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, " S"]:
        """Corr. of each sample, as the mean over windows; a clip shorter than a window is one window."""
        return np.asarray(self.score_sounds([speech], head, gaze)[0])

    @torch.no_grad()
    def score_sounds(
        self, sounds: Sequence[Float[ndarray, "_ C"]], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, "N S"]:
        """Corr. of each sample under each of several sounds, over the frames that sound and motion share.

        The features of a motion window are computed once for all sounds.
        """
        motion = torch.from_numpy(part_angles(self.part, head, gaze).astype(np.float32))
        motion_features: dict[tuple[int, int], Tensor] = {}
        found = []
        for sound in sounds:
            speech_features = torch.from_numpy(sound[:, self.critic.speech_channels.numpy()].astype(np.float32))
            frames = min(len(sound), motion.shape[1])
            values = []
            for start in range(0, max(0, frames - self.frames) + 1, self.hop):
                stop = min(start + self.frames, frames)
                if (start, stop) not in motion_features:
                    motion_features[start, stop] = self.critic.motion(motion[:, start:stop]).flatten(1)
                window_features = self.critic.speech(speech_features[None, start:stop]).flatten(1)
                values.append(torch.cosine_similarity(window_features, motion_features[start, stop]).numpy())
            found.append(np.mean(values, axis=0))
        return np.asarray(found)
