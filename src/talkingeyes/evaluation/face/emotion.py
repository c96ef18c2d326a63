"""Which emotion a face shows, by a classifier that has seen true faces of the train split alone.

Linear discriminants with a shrunken covariance (Friedman 1989), every emotion as likely as the others, on the mean and
the SD over a clip of where the named points of the face are, in millimetres. Weights of shapes would not do: several
look alike, and a fit shares out among them what they do. `SHRINKAGE` is the middle of the range (0.1 to 0.6) that tells
speakers apart from whom it did not learn equally well, on the train split.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.face.surface import FaceSurface

SHRINKAGE = 0.3
MIN_VARIANCE_MM2 = 1e-6


def emotion_features(surface: FaceSurface, samples: FaceSamples) -> Float[ndarray, "S F"]:
    """What is looked at, of each sample: mean and SD over time of the named points."""
    found = []
    for sample in range(len(samples.jaw)):
        points = surface.landmarks_mm(samples, sample).reshape(samples.jaw.shape[1], -1)
        found.append(np.concatenate([points.mean(axis=0), points.std(axis=0)]))
    return np.array(found)


@dataclass(frozen=True)
class EmotionClassifier:
    """Scores are linear in features."""

    emotions: tuple[str, ...]
    weights: Float[ndarray, "K F"]
    offsets: Float[ndarray, " K"]

    @classmethod
    def learn(cls, feature_rows: Float[ndarray, "N F"], emotions: Sequence[str]) -> EmotionClassifier:
        """From clips and their emotions, of at least two of which there must be a clip."""
        names = tuple(sorted(set(emotions)))
        index = np.array([names.index(each) for each in emotions])
        means = np.array([feature_rows[index == kind].mean(axis=0) for kind in range(len(names))])
        left = feature_rows - means[index]
        covariance = left.T @ left / max(len(feature_rows) - len(names), 1)
        spread = max(float(np.trace(covariance)) / len(covariance), MIN_VARIANCE_MM2)
        covariance += SHRINKAGE * spread * np.eye(len(covariance))
        weights = np.linalg.solve(covariance, means.T).T
        return cls(names, weights, -0.5 * np.einsum("kf,kf->k", weights, means))

    def predict(self, feature_rows: Float[ndarray, "N F"]) -> list[str]:
        """The likeliest emotion of each."""
        best = (feature_rows @ self.weights.T + self.offsets).argmax(axis=1)
        return [self.emotions[kind] for kind in best]


def balanced_accuracy(hits: Float[ndarray, " N"], emotions: Sequence[str] | ndarray) -> float:
    """The share of hits of each emotion, averaged over emotions: chance is one in as many as there are."""
    kinds = np.asarray(emotions)
    return float(np.mean([hits[kinds == kind].mean() for kind in np.unique(kinds)]))
