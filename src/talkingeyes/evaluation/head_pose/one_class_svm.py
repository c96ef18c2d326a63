"""Head-speech consistency by one-class SVMs on correlations (Zhang et al., section 5.1, eq. 9, Table 1).

For every 256 frames, the Pearson correlations of 29 speech features with the six numbers of the pose give 174 features.
A one-class SVM (Schoelkopf et al. 2001) is trained on each speaker's own speech and poses of the train split. The
metric is the fraction of test windows that it accepts, for own poses and for poses of other windows of each speaker.

Unlike the paper, whose 29 speech features are the characters of DeepSpeech, PCA reduces the embedding to 29.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings
from talkingeyes.evaluation.head_pose.windows import PoseWindows

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
