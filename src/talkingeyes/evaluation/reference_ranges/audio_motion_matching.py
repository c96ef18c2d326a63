"""Discrimination of matched sound from other sounds of the same speaker, over windows of 8 s.

The critic's two towers (evaluation/critic/contrastive_training.py) are trained on the true motion of the train split
(gaze in space, head, jaw) and tested on unseen sounds and speakers. Gaze and head are combined by the sum of their
similarities. p is the rank of the mean similarity of matched pairs among random pairings within each speaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.critic.contrastive_training import (
    ChannelSelection,
    CriticSettings,
    first_windows,
    train_critic,
)
from talkingeyes.evaluation.paper_metrics.corr import auc
from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, measurement
from talkingeyes.models.contrastive_critic import similarity

PERMUTATIONS = 999
MIN_WINDOWS = 20


@dataclass(frozen=True)
class SimilarityMatrix:
    """Similarity of every sound with every motion, and mask of the pairs of one speaker with different sounds."""

    cosine: Float[ndarray, "N N"]
    negatives: Bool[ndarray, "N N"]

    def __add__(self, other: SimilarityMatrix) -> SimilarityMatrix:
        """Sum of both similarities, each divided by its standard deviation."""
        return SimilarityMatrix(self.cosine / self.cosine.std() + other.cosine / other.cosine.std(), self.negatives)


def train_similarity(
    part: str,
    train: Sequence[Recording],
    judged: Sequence[Recording],
    channel_selection: ChannelSelection,
    settings: CriticSettings,
) -> SimilarityMatrix:
    """Train a critic on `train` and compute the similarity of all pairs of recordings in `judged`."""
    trained = train_critic(part, train, channel_selection, settings).corr
    group = first_windows(judged, part, trained.critic.speech_channels.numpy(), trained.frames)
    with torch.no_grad():
        found = similarity(trained.critic.speech(group.speech_features), trained.critic.motion(group.angles))
    return SimilarityMatrix(found.numpy().astype(np.float64), group.negatives)


def matching_auc(similar: SimilarityMatrix) -> Measurement:
    """AUC of matched pairs against mismatched pairs of the same speaker."""
    known = similar.negatives.any(axis=1)
    right = np.diag(similar.cosine)[known]
    return measurement(float(auc(right, similar.cosine[similar.negatives])), int(known.sum()), "windows", MIN_WINDOWS)


def permutation_p_value(similar: SimilarityMatrix, seed: int) -> Measurement:
    """p value of the mean similarity of matched pairs, by permutation within speakers."""
    rng, count = np.random.default_rng(seed), len(similar.cosine)
    same = similar.negatives | np.eye(count, dtype=bool)
    groups = [np.flatnonzero(row) for index, row in enumerate(same) if np.flatnonzero(row)[0] == index]
    right, above = np.diag(similar.cosine).mean(), 0
    for _ in range(PERMUTATIONS):
        order = np.arange(count)
        for group in groups:
            order[group] = rng.permutation(group)
        above += similar.cosine[np.arange(count), order].mean() >= right
    return measurement((1 + above) / (1 + PERMUTATIONS), count, "windows", MIN_WINDOWS)
