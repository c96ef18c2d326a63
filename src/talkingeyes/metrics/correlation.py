"""Corr. (section V-B.3): the cosine of the critic's features of sound and motion over windows of 8 s; the critic's AUC.

Higher is not better: a conditional mean is more predictable than any true motion, and a constant can beat a random
draw. So Corr. is read as a distance to that of the truth, beside shuffled truth and a constant (LEARNING.md, point 9).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.learning.checkpoint import load
from talkingeyes.models.critic import MIRROR, Critic, CriticNetworkSettings, angles


def auc(positives: Float[ndarray, " P"], negatives: Float[ndarray, " N"]) -> float:
    """Chance that a positive scores above a negative; ties count half."""
    ordered = np.sort(negatives)
    below, not_above = (np.searchsorted(ordered, positives, side=side) for side in ("left", "right"))
    return float((below + not_above).mean() / 2 / len(ordered))


class Correlation:
    """A frozen critic of one part, as a metric."""

    def __init__(self, part: str, critic: Critic, frames: int, hop: int) -> None:
        """`frames` a window, one window every `hop` frames."""
        self.part, self.critic, self.frames, self.hop = part, critic.eval(), frames, hop

    @classmethod
    def load(cls, folder: Path, part: str) -> Correlation:
        """From what the stage `critic` wrote."""
        checkpoint = load(folder / part)
        tensors, config = checkpoint.tensors, checkpoint.config
        critic = Critic(
            CriticNetworkSettings.model_validate(config["network"]),
            tensors["speech_channels"],
            tensors["speech_mean"],
            tensors["speech_std"],
            tensors["motion_scale"],
            len(MIRROR[part]),
        )
        critic.load_state_dict(tensors)
        return cls(part, critic, int(config["frames"]), int(config["hop"]))

    def __call__(
        self, speech: Float[ndarray, "T C"], head: Float[ndarray, "S T 3"], gaze: Float[ndarray, "S T 2 3"]
    ) -> Float[ndarray, " S"]:
        """Corr. of each sample: mean over the windows; a clip shorter than a window is one window."""
        motion, heard = angles(self.part, head, gaze), speech[:, self.critic.speech_channels.numpy()]
        starts = range(0, max(0, len(speech) - self.frames) + 1, self.hop)
        values = [self._window(heard[s : s + self.frames], motion[:, s : s + self.frames]) for s in starts]
        return np.asarray(np.mean(values, axis=0))

    @torch.no_grad()
    def _window(self, heard: Float[ndarray, "T H"], motion: Float[ndarray, "S T A"]) -> Float[ndarray, " S"]:
        one = self.critic.speech(torch.from_numpy(heard.astype(np.float32))[None])
        others = self.critic.motion(torch.from_numpy(motion.astype(np.float32)))
        return np.asarray(torch.cosine_similarity(one.flatten(1), others.flatten(1)).numpy())
