"""What a critic can tell: AUC against wrong pairs, and Corr. of the truth beside that of baselines.

A Corr. means little without this beside it: how often the right motion beats another of the same speaker, and what the
truth, the truth under other sounds, and a motionless face score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.corpus.windows import Recording
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, Statistic, bootstrap, mean_of
from talkingeyes.evaluation.contrast import first_windows
from talkingeyes.evaluation.correlation import Correlation, auc
from talkingeyes.models.critic import similarity


@dataclass(frozen=True)
class Verdict:
    """Over one group of clips; None where no two sounds share a speaker. `advantage` is truth minus shuffled."""

    auc_same_speaker: Estimate | None
    auc_all: Estimate | None
    corr_truth: Estimate
    corr_shuffled: Estimate | None
    corr_constant: Estimate
    advantage: Estimate | None


@torch.no_grad()
def judge(corr: Correlation, recordings: Sequence[Recording], settings: BootstrapSettings) -> Verdict:
    """The verdict over the first windows of the recordings; `truth` is fitted motion, which the critic learns from."""
    group = first_windows(recordings, corr.part, corr.critic.speech_channels.numpy(), corr.frames)
    speech = corr.critic.speech(group.heard)
    similar = similarity(speech, corr.critic.motion(group.angles)).numpy().astype(np.float64)
    still = similarity(speech, corr.critic.motion(torch.zeros_like(group.angles[:1]))).numpy()[:, 0].astype(np.float64)
    right, count = np.diag(similar).copy(), len(similar)
    others = [similar[row, np.arange(count) != row] for row in range(count)]
    rivals = [similar[row, group.rivals[row]] for row in range(count)]
    paired = np.flatnonzero(group.rivals.any(axis=1))
    shuffled = np.array([rivals[row].mean() for row in paired])
    same = [rivals[row] for row in paired]
    return Verdict(
        auc_same_speaker=bootstrap(_auc(right[paired], same), len(paired), settings) if len(paired) else None,
        auc_all=bootstrap(_auc(right, others), count, settings) if count > 1 else None,
        corr_truth=bootstrap(mean_of(right), count, settings),
        corr_shuffled=bootstrap(mean_of(shuffled), len(paired), settings) if len(paired) else None,
        corr_constant=bootstrap(mean_of(still), count, settings),
        advantage=bootstrap(mean_of(right[paired] - shuffled), len(paired), settings) if len(paired) else None,
    )


def _auc(right: Float[ndarray, " N"], wrong: Sequence[Float[ndarray, " _"]]) -> Statistic:
    def statistic(clips: Int[ndarray, " N"]) -> float:
        return auc(right[clips], np.concatenate([wrong[clip] for clip in clips]))

    return statistic
