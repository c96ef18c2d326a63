"""Who moves like that? A classifier of speakers from head motion on 256 frames (Zhang et al., section 5.2.2, Table 3).

Trained on true motion of the train split, its weights chosen on val. Of a generated motion it tells with which
confidence it is taken for one of the speaker that it was made for. It sees motion (differences of frames), in units
of the train split's deviations, never where the head is; a still head gets the same answer whoever it is for.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.settings import Settings
from talkingeyes.training.loop import LoopSettings, train


class ClassifierSettings(Settings):
    """Its size and training."""

    seed: int
    width: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    loop: LoopSettings


@dataclass(frozen=True)
class LabelledWindows:
    """Windows of poses and the index of the speaker of each."""

    pose: Float[ndarray, "N L 6"]
    speaker: Int[ndarray, " N"]


@dataclass(frozen=True)
class ClassifierScores:
    """By speaker, over the windows made for that speaker: mean confidence in that speaker, and share told right."""

    confidence: Float[ndarray, " K"]
    accuracy: Float[ndarray, " K"]


class PoseClassifier(nn.Module):
    """Strided convolutions, the mean over time, two dense layers."""

    scale: Tensor

    def __init__(self, settings: ClassifierSettings, speakers: int) -> None:
        super().__init__()
        width = settings.width
        self.register_buffer("scale", torch.ones(6))
        sizes = [6, width, width, 2 * width, 2 * width]
        layers: list[nn.Module] = []
        for taken, given in pairwise(sizes):
            layers += [nn.Conv1d(taken, given, 7, stride=2, padding=3), nn.BatchNorm1d(given), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers)
        self.dense = nn.Sequential(
            nn.Dropout(settings.dropout),
            nn.Linear(2 * width, width),
            nn.ReLU(),
            nn.Linear(width, speakers),
        )

    def forward(self, pose: Float[Tensor, "B L 6"]) -> Float[Tensor, "B K"]:
        """Logits of speakers."""
        motion = pose.diff(dim=1) / self.scale
        scores: Tensor = self.dense(self.convolutions(motion.transpose(1, 2)).mean(-1))
        return scores

    @torch.no_grad()
    def probabilities(self, pose: Float[ndarray, "N L 6"]) -> Float[ndarray, "N K"]:
        """Confidence in each speaker."""
        parts = torch.from_numpy(np.asarray(pose, np.float32)).split(256)
        return torch.cat([self(part).softmax(-1) for part in parts]).numpy()


class ClassifierTask:
    """Cross-entropy on windows, speakers drawn alike."""

    def __init__(self, settings: ClassifierSettings, train: LabelledWindows, val: LabelledWindows) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.train, self.val = settings, train, val
        self.rng = np.random.default_rng(settings.seed)
        self.windows_by_speaker = [np.flatnonzero(train.speaker == each) for each in np.unique(train.speaker)]
        self.module = PoseClassifier(settings, len(self.windows_by_speaker))
        self.module.scale.copy_(torch.from_numpy(np.diff(train.pose, axis=1).std((0, 1))))

    def losses(self, step: int) -> dict[str, Tensor]:
        """Cross-entropy of a batch."""
        whose = self.rng.integers(len(self.windows_by_speaker), size=self.settings.loop.batch)
        index = np.array([self.rng.choice(self.windows_by_speaker[each]) for each in whose])
        logits = self.module(torch.from_numpy(self.train.pose[index].astype(np.float32)))
        return {"total": nn.functional.cross_entropy(logits, torch.from_numpy(self.train.speaker[index]))}

    def validate(self) -> dict[str, float]:
        """Share of val windows told right, which is what weights are chosen by, and the mean confidence."""
        judged = classifier_scores(self.module, self.val)
        return {
            "validation_score": float(np.nanmean(judged.confidence)),
            "accuracy": float(np.nanmean(judged.accuracy)),
        }


def train_classifier(
    settings: ClassifierSettings, of_train: LabelledWindows, of_val: LabelledWindows
) -> PoseClassifier:
    """A classifier with the weights that are best on val."""
    task = ClassifierTask(settings, of_train, of_val)
    train(task, settings.loop, "pose classifier")
    return task.module.eval()


def classifier_scores(classifier: PoseClassifier, windows: LabelledWindows) -> ClassifierScores:
    """Confidence in, and choice of, the speaker that each window is of or was made for; NaN for one without windows."""
    found = classifier.probabilities(windows.pose)
    count = found.shape[1]
    own = found[np.arange(len(found)), windows.speaker]
    right = found.argmax(1) == windows.speaker
    of_speaker = [windows.speaker == each for each in range(count)]
    return ClassifierScores(
        np.array([own[each].mean() if each.any() else np.nan for each in of_speaker]),
        np.array([right[each].mean() if each.any() else np.nan for each in of_speaker]),
    )
