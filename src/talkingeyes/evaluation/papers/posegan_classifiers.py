"""Who moves, and to which speech: classifiers of windows of 256 frames of poses (Zhang et al., sections 4.3 and 5).

The classifier of speakers (section 5.2.2, Table 3) is trained on true motion of the train split and its checkpoint is
chosen on val. For generated motion it gives the confidence that the motion belongs to the intended speaker. Its input
is motion only (differences of frames, in standard deviations of the train split), never the pose; a still head gets the
same answer for every speaker. Its confidences for a new person are the weights of the learnt styles of the training
speakers; the largest selects the nearest style.

Head-speech consistency is measured by one-class SVMs on correlations (section 5.1, eq. 9, Table 1). For every window,
the Pearson correlations of 29 speech features with the six numbers of the pose give 174 features. A one-class SVM
(Schoelkopf et al. 2001) is trained on each speaker's own speech and poses of the train split. The metric is the
fraction of test windows that it accepts, for own poses and for poses of other windows of each speaker.

Unlike the paper, whose 29 speech features are the characters of DeepSpeech, PCA reduces the embedding to 29.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from pydantic import Field
from torch import Tensor, nn

from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings
from talkingeyes.corpus.poses import PoseRecording
from talkingeyes.training.loop import LoopSettings, train


@dataclass(frozen=True)
class PoseWindows:
    """N windows of L frames: standardised speech embedding, centred poses, and speaker indices."""

    speech: Float[ndarray, "N L C"]
    pose: Float[ndarray, "N L 6"]
    speaker: Int[ndarray, " N"]

    def __len__(self) -> int:
        return len(self.pose)


def sliding_windows(frames: Float[ndarray, "T C"], length: int, hop: int) -> Float[ndarray, "N L C"]:
    """Windows of an array, `hop` frames apart; none if it is shorter than a window."""
    starts = np.arange(0, len(frames) - length + 1, hop)
    return np.asarray(frames[starts[:, None] + np.arange(length)])


def pose_windows(recordings: Sequence[PoseRecording], speakers: Sequence[str], length: int, hop: int) -> PoseWindows:
    """Windows of recordings of the given speakers; others are left out."""
    known = [each for each in recordings if each.clip.speaker in speakers and len(each) >= length]
    poses = [sliding_windows(each.pose, length, hop) for each in known]
    return PoseWindows(
        speech=np.concatenate([sliding_windows(each.speech, length, hop) for each in known]),
        pose=np.concatenate(poses),
        speaker=np.repeat([speakers.index(each.clip.speaker) for each in known], [len(pose) for pose in poses]),
    )


MIN_FRAMES = 32  # of a new person, about a second; below, strided convolutions cover only padded borders


class ClassifierSettings(Settings):
    """Size and training of the classifier."""

    seed: int
    width: Annotated[int, Field(gt=0)]
    dropout: Annotated[float, Field(ge=0, lt=1)]
    loop: LoopSettings


@dataclass(frozen=True)
class LabelledWindows:
    """Windows of poses with speaker indices."""

    pose: Float[ndarray, "N L 6"]
    speaker: Int[ndarray, " N"]


@dataclass(frozen=True)
class ClassifierScores:
    """Mean confidence and accuracy by speaker, over the windows generated for that speaker."""

    confidence: Float[ndarray, " K"]
    accuracy: Float[ndarray, " K"]


class PoseClassifier(nn.Module):
    """Strided convolutions, mean over time, and two dense layers."""

    scale: Tensor

    def __init__(self, settings: ClassifierSettings, speakers: int) -> None:
        super().__init__()
        width = settings.width
        self.register_buffer("scale", torch.ones(6))
        sizes = [6, width, width, 2 * width, 2 * width]
        layers: list[nn.Module] = []
        for width_in, width_out in pairwise(sizes):
            layers += [nn.Conv1d(width_in, width_out, 7, stride=2, padding=3), nn.BatchNorm1d(width_out), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers)
        self.dense = nn.Sequential(
            nn.Dropout(settings.dropout),
            nn.Linear(2 * width, width),
            nn.ReLU(),
            nn.Linear(width, speakers),
        )

    def forward(self, pose: Float[Tensor, "B L 6"]) -> Float[Tensor, "B K"]:
        """Logits over speakers."""
        motion = pose.diff(dim=1) / self.scale
        scores: Tensor = self.dense(self.convolutions(motion.transpose(1, 2)).mean(-1))
        return scores

    @torch.no_grad()
    def probabilities(self, pose: Float[ndarray, "N L 6"]) -> Float[ndarray, "N K"]:
        """Probability of each speaker."""
        parts = torch.from_numpy(np.asarray(pose, np.float32)).split(256)
        return torch.cat([self(part).softmax(-1) for part in parts]).numpy()


def blend_styles(classifier: PoseClassifier, pose: Float[ndarray, "T 6"]) -> Float[ndarray, " K"]:
    """Weights of K learnt styles for a few seconds of a new person's poses. Raises InputError below `MIN_FRAMES`."""
    if len(pose) < MIN_FRAMES:
        raise InputError(f"style: should have at least {MIN_FRAMES} frames of motion, got {len(pose)}")
    return np.asarray(classifier.probabilities((pose - pose.mean(0))[None])[0])


class ClassifierTask:
    """Training task: cross-entropy on windows, with speakers sampled uniformly."""

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
        """Mean confidence on val (`validation_score`, which the checkpoint is chosen by) and accuracy."""
        scores = classifier_scores(self.module, self.val)
        return {
            "validation_score": float(np.nanmean(scores.confidence)),
            "accuracy": float(np.nanmean(scores.accuracy)),
        }


def train_classifier(
    settings: ClassifierSettings, of_train: LabelledWindows, of_val: LabelledWindows
) -> PoseClassifier:
    """Train a classifier and keep the checkpoint that is best on val."""
    task = ClassifierTask(settings, of_train, of_val)
    train(task, settings.loop, "pose classifier")
    return task.module.eval()


def classifier_scores(classifier: PoseClassifier, windows: LabelledWindows) -> ClassifierScores:
    """Confidence and accuracy of the true or intended speaker, by speaker; NaN for speakers without windows."""
    found = classifier.probabilities(windows.pose)
    count = found.shape[1]
    own = found[np.arange(len(found)), windows.speaker]
    right = found.argmax(1) == windows.speaker
    of_speaker = [windows.speaker == each for each in range(count)]
    return ClassifierScores(
        np.array([own[each].mean() if each.any() else np.nan for each in of_speaker]),
        np.array([right[each].mean() if each.any() else np.nan for each in of_speaker]),
    )


MAX_PCA_FRAMES = 20_000


class SVMSettings(Settings):
    """Settings of the one-class SVM; `nu` is the fraction of training windows that may be rejected."""

    features: Annotated[int, Field(gt=0)]
    nu: Annotated[float, Field(gt=0, lt=1)]
    seed: int


@dataclass(frozen=True)
class AcceptanceRates:
    """Acceptance rates by speaker of the speech, with own poses and with poses of each speaker (columns)."""

    matched: Float[ndarray, " K"]
    random_poses: Float[ndarray, "K K"]


def correlations(speech: Float[ndarray, "N L S"], pose: Float[ndarray, "N L P"]) -> Float[ndarray, "N F"]:
    """Eq. 9 for all pairs of a speech feature and a number of the pose; 0 if either does not vary."""
    ours, theirs = (each - each.mean(1, keepdims=True) for each in (speech.astype(float), pose.astype(float)))
    norms = (
        np.sqrt(np.einsum("nls,nls->ns", ours, ours))[:, :, None]
        * np.sqrt(np.einsum("nlp,nlp->np", theirs, theirs))[:, None]
    )
    products = np.einsum("nls,nlp->nsp", ours, theirs)
    found = np.divide(products, norms, out=np.zeros_like(products), where=norms > 1e-12)
    return np.asarray(found.reshape(len(found), -1))


def fit_pca(speech: Float[ndarray, "N L C"], settings: SVMSettings) -> Any:
    """Fit the PCA of speech features to frames of the train split."""
    from sklearn.decomposition import PCA

    frames = speech.reshape(-1, speech.shape[-1])
    chosen = np.random.default_rng(settings.seed).choice(len(frames), min(MAX_PCA_FRAMES, len(frames)), replace=False)
    return PCA(settings.features, random_state=settings.seed).fit(frames[chosen])


def apply_pca(pca: Any, speech: Float[ndarray, "N L C"]) -> Float[ndarray, "N L S"]:
    """Project the speech features of windows on the principal components."""
    return np.asarray(pca.transform(speech.reshape(-1, speech.shape[-1])).reshape(*speech.shape[:2], -1))


def acceptance_rates(
    train: PoseWindows, test: PoseWindows, speakers: Sequence[str], settings: SVMSettings, repeats: int = 5
) -> AcceptanceRates:
    """Compute Table 1. A random pose is that of a random test window of the speaker, averaged over `repeats`."""
    from sklearn.svm import OneClassSVM

    pca, rng = fit_pca(train.speech, settings), np.random.default_rng(settings.seed)
    speech_train, speech_test = apply_pca(pca, train.speech), apply_pca(pca, test.speech)
    own, others = np.full(len(speakers), np.nan), np.full((len(speakers), len(speakers)), np.nan)
    for index in range(len(speakers)):
        mine, tested = train.speaker == index, np.flatnonzero(test.speaker == index)
        if not mine.any() or not len(tested):
            continue
        svm = OneClassSVM(nu=settings.nu, gamma="scale").fit(correlations(speech_train[mine], train.pose[mine]))

        def accepted(poses: ndarray, svm: Any = svm, tested: ndarray = tested) -> float:
            return float((svm.predict(correlations(speech_test[tested], poses)) > 0).mean())

        own[index] = accepted(test.pose[tested])
        for other in range(len(speakers)):
            sources = np.flatnonzero(test.speaker == other)
            if len(sources):
                rates = [accepted(test.pose[rng.choice(sources, len(tested))]) for _ in range(repeats)]
                others[index, other] = np.mean(rates)
    return AcceptanceRates(own, others)
