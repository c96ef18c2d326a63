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
from talkingeyes.evaluation.contrast import CriticSettings, Hearing, first_windows, learn
from talkingeyes.evaluation.correlation import auc
from talkingeyes.evaluation.facts.clip import Measured, measured
from talkingeyes.models.critic import similarity

DRAWS = 999
LEAST_WINDOWS = 20


@dataclass(frozen=True)
class Similar:
    """Similarity of every sound with every motion, and which pairs are of one speaker but not of one sound."""

    cosine: Float[ndarray, "N N"]
    rivals: Bool[ndarray, "N N"]

    def __add__(self, other: Similar) -> Similar:
        """Both scores together, each in its own standard deviations."""
        return Similar(self.cosine / self.cosine.std() + other.cosine / other.cosine.std(), self.rivals)


def similarities(
    part: str, train: Sequence[Recording], judged: Sequence[Recording], hearing: Hearing, settings: CriticSettings
) -> Similar:
    """Train on some recordings, compare all pairs of others."""
    learnt = learn(part, train, hearing, settings).corr
    group = first_windows(judged, part, learnt.critic.speech_channels.numpy(), learnt.frames)
    with torch.no_grad():
        found = similarity(learnt.critic.speech(group.heard), learnt.critic.motion(group.angles))
    return Similar(found.numpy().astype(np.float64), group.rivals)


def matched(similar: Similar) -> Measured:
    """AUC of right pairs against pairs of one speaker."""
    known = similar.rivals.any(axis=1)
    right = np.diag(similar.cosine)[known]
    return measured(float(auc(right, similar.cosine[similar.rivals])), int(known.sum()), "windows", LEAST_WINDOWS)


def by_chance(similar: Similar, seed: int) -> Measured:
    """p by permutation within speakers."""
    random, count = np.random.default_rng(seed), len(similar.cosine)
    same = similar.rivals | np.eye(count, dtype=bool)
    groups = [np.flatnonzero(row) for index, row in enumerate(same) if np.flatnonzero(row)[0] == index]
    right, above = np.diag(similar.cosine).mean(), 0
    for _ in range(DRAWS):
        order = np.arange(count)
        for group in groups:
            order[group] = random.permutation(group)
        above += similar.cosine[np.arange(count), order].mean() >= right
    return measured((1 + above) / (1 + DRAWS), count, "windows", LEAST_WINDOWS)
