"""Scores of a critic: its AUC against wrong pairs, and Corr. of the truth and of baselines.

A Corr. cannot be interpreted without them: how often the right motion scores above another motion of the same speaker,
and the Corr. of the truth, of the truth under other sounds, and of a motionless face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, Statistic, bootstrap, mean_statistic
from talkingeyes.evaluation.critic.contrastive_training import first_windows
from talkingeyes.evaluation.paper_metrics.corr import CriticCorrelation, auc
from talkingeyes.models.contrastive_critic import similarity


@dataclass(frozen=True)
class CriticScores:
    """Scores over a group of clips; None where they need two sounds of a speaker and no speaker has two.

    `corr_minus_shuffled` is `corr_truth` minus `corr_shuffled`, over the same clips.
    """

    auc_same_speaker: Estimate | None
    auc_all: Estimate | None
    corr_truth: Estimate
    corr_shuffled: Estimate | None
    corr_constant: Estimate
    corr_minus_shuffled: Estimate | None


@torch.no_grad()
def score_critic(corr: CriticCorrelation, recordings: Sequence[Recording], settings: BootstrapSettings) -> CriticScores:
    """Score a critic on the first windows of recordings; "truth" is fitted motion, as in the training of the critic."""
    group = first_windows(recordings, corr.part, corr.critic.speech_channels.numpy(), corr.frames)
    speech = corr.critic.speech(group.speech_features)
    similar = similarity(speech, corr.critic.motion(group.angles)).numpy().astype(np.float64)
    still = similarity(speech, corr.critic.motion(torch.zeros_like(group.angles[:1]))).numpy()[:, 0].astype(np.float64)
    right, count = np.diag(similar).copy(), len(similar)
    others = [similar[row, np.arange(count) != row] for row in range(count)]
    negatives = [similar[row, group.negatives[row]] for row in range(count)]
    paired = np.flatnonzero(group.negatives.any(axis=1))
    shuffled = np.array([negatives[row].mean() for row in paired])
    same = [negatives[row] for row in paired]
    return CriticScores(
        auc_same_speaker=bootstrap(_auc(right[paired], same), len(paired), settings) if len(paired) else None,
        auc_all=bootstrap(_auc(right, others), count, settings) if count > 1 else None,
        corr_truth=bootstrap(mean_statistic(right), count, settings),
        corr_shuffled=bootstrap(mean_statistic(shuffled), len(paired), settings) if len(paired) else None,
        corr_constant=bootstrap(mean_statistic(still), count, settings),
        corr_minus_shuffled=bootstrap(mean_statistic(right[paired] - shuffled), len(paired), settings)
        if len(paired)
        else None,
    )


def _auc(right: Float[ndarray, " N"], wrong: Sequence[Float[ndarray, " _"]]) -> Statistic:
    def statistic(clips: Int[ndarray, " N"]) -> float:
        return auc(right[clips], np.concatenate([wrong[clip] for clip in clips]))

    return statistic
