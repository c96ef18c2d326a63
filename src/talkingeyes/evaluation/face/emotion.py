"""Emotion recognition from a face, by a classifier trained on true faces of the train split only.

Linear discriminant analysis with a shrunken covariance (Friedman 1989) and equal priors, on the mean and the SD over a
clip of the positions of the landmarks, in millimetres. Blend shape weights would not do: several shapes look alike, and
a fit distributes the motion among them. `SHRINKAGE` is the middle of the range (0.1 to 0.6) that works equally well on
held-out speakers of the train split.
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
    """Features of each sample: mean and SD over time of the landmark displacements."""
    found = []
    for sample in range(len(samples.jaw)):
        points = surface.landmarks_mm(samples, sample).reshape(samples.jaw.shape[1], -1)
        found.append(np.concatenate([points.mean(axis=0), points.std(axis=0)]))
    return np.array(found)


@dataclass(frozen=True)
class EmotionClassifier:
    """Linear discriminant classifier of emotions."""

    emotions: tuple[str, ...]
    weights: Float[ndarray, "K F"]
    offsets: Float[ndarray, " K"]

    @classmethod
    def fit(cls, feature_rows: Float[ndarray, "N F"], emotions: Sequence[str]) -> EmotionClassifier:
        """Fit the classifier to clips and their emotions; at least two emotions must occur."""
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
        """Most likely emotion of each row."""
        best = (feature_rows @ self.weights.T + self.offsets).argmax(axis=1)
        return [self.emotions[kind] for kind in best]


def balanced_accuracy(hits: Float[ndarray, " N"], emotions: Sequence[str] | ndarray) -> float:
    """Hit rate of each emotion, averaged over emotions; chance is 1 / number of emotions."""
    kinds = np.asarray(emotions)
    return float(np.mean([hits[kinds == kind].mean() for kind in np.unique(kinds)]))
