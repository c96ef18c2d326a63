"""Whether the right sound can be told from a wrong one of the same speaker, over windows of eight seconds.

The critic's two towers (evaluation/contrast.py) are trained here on the true motion of the train split, of gaze in
space, of the head and of the jaw, and judged on sounds and speakers that they have not seen. Gaze and head together
score by the sum of their similarities. p is that of the mean similarity of right pairs among pairings drawn within each
speaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.corpus.windows import Recording
from talkingeyes.evaluation.contrast import ChannelSelection, CriticSettings, first_windows, train_critic
from talkingeyes.evaluation.correlation import auc
from talkingeyes.evaluation.facts.clip import Measurement, measurement
from talkingeyes.models.critic import similarity

PERMUTATIONS = 999
MIN_WINDOWS = 20


@dataclass(frozen=True)
class SimilarityMatrix:
    """Similarity of every sound with every motion, and which pairs are of one speaker but not of one sound."""

    cosine: Float[ndarray, "N N"]
    negatives: Bool[ndarray, "N N"]

    def __add__(self, other: SimilarityMatrix) -> SimilarityMatrix:
        """Both scores together, each in its own standard deviations."""
        return SimilarityMatrix(self.cosine / self.cosine.std() + other.cosine / other.cosine.std(), self.negatives)


def train_similarity(
    part: str,
    train: Sequence[Recording],
    judged: Sequence[Recording],
    channel_selection: ChannelSelection,
    settings: CriticSettings,
) -> SimilarityMatrix:
    """Train on some recordings, compare all pairs of others."""
    learnt = train_critic(part, train, channel_selection, settings).corr
    group = first_windows(judged, part, learnt.critic.speech_channels.numpy(), learnt.frames)
    with torch.no_grad():
        found = similarity(learnt.critic.speech(group.speech_features), learnt.critic.motion(group.angles))
    return SimilarityMatrix(found.numpy().astype(np.float64), group.negatives)


def matching_auc(similar: SimilarityMatrix) -> Measurement:
    """AUC of right pairs against pairs of one speaker."""
    known = similar.negatives.any(axis=1)
    right = np.diag(similar.cosine)[known]
    return measurement(float(auc(right, similar.cosine[similar.negatives])), int(known.sum()), "windows", MIN_WINDOWS)


def permutation_p_value(similar: SimilarityMatrix, seed: int) -> Measurement:
    """p by permutation within speakers."""
    random, count = np.random.default_rng(seed), len(similar.cosine)
    same = similar.negatives | np.eye(count, dtype=bool)
    groups = [np.flatnonzero(row) for index, row in enumerate(same) if np.flatnonzero(row)[0] == index]
    right, above = np.diag(similar.cosine).mean(), 0
    for _ in range(PERMUTATIONS):
        order = np.arange(count)
        for group in groups:
            order[group] = random.permutation(group)
        above += similar.cosine[np.arange(count), order].mean() >= right
    return measurement((1 + above) / (1 + PERMUTATIONS), count, "windows", MIN_WINDOWS)
