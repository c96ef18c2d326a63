"""Gaze from head motion and speech by canonical correlation: the early method that TalkingEyes is shown beside.

Le, Ma and Deng, "Live Speech Driven Head-and-Eye Motion Generators" (TVCG 2012) relate gaze to head motion and speech
features by non-linear dynamical canonical correlation analysis. TalkingEyes shows it by film alone; its program is not
public, and this is not it but the same idea in closed form:

- non-linear: what is heard and how the head moves is lifted by random Fourier features of a Gaussian kernel (Rahimi and
  Recht 2007), which keeps the analysis linear in memory, where kernel matrices are square in frames;
- dynamical: both sides are windows, speech and head at several lags against a stretch of gaze; stretches that overlap
  are averaged.

The strongest canonical components give gaze by the rank-reduced regression that they are the solution of. A head and a
sound have one gaze: what differs between samples is the head, which another model moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings


class CanonicalCorrelationSettings(Settings):
    """How gaze is related to speech and head."""

    # Principal components of the speech features.
    speech_components: Annotated[int, Field(gt=0)]
    # Frames before (negative) and after a frame at which speech and head are looked at.
    lags_frames: tuple[int, ...] = Field(min_length=1)
    # Frames of a stretch of gaze: so many before and after a frame.
    context_frames: Annotated[int, Field(ge=0)]
    # Random Fourier features, and the width of their kernel in units of the spread of what they see.
    fourier_features: Annotated[int, Field(gt=0)]
    kernel_width: Annotated[float, Field(gt=0)]
    # Canonical components that are kept.
    canonical_components: Annotated[int, Field(gt=0)]
    # Added to both covariances, as a share of the mean variance.
    ridge: Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class Example:
    """A training motion; speech is standardised."""

    speech: Float[ndarray, "T C"]
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]


@dataclass(frozen=True)
class FeatureMap:
    """From speech and head to the features that gaze is related to."""

    speech_basis: Float[ndarray, "C P"]
    mean: Float[ndarray, " D"]
    scale: Float[ndarray, " D"]
    frequencies: Float[ndarray, "D F"]
    phases: Float[ndarray, " F"]


@dataclass(frozen=True)
class CanonicalCorrelation:
    """The relation that was found: gaze stretches are `offset + (features - centre) @ weights`."""

    feature_map: FeatureMap
    centre: Float[ndarray, " X"]
    weights: Float[ndarray, "X Y"]
    offset: Float[ndarray, " Y"]
    correlations: Float[ndarray, " K"]  # canonical, of the components that are kept


def fit_canonical_correlation(
    settings: CanonicalCorrelationSettings, examples: Sequence[Example], seed: int
) -> CanonicalCorrelation:
    """Find the relation in training motions, read one after the other."""
    feature_map = _fit_feature_map(settings, examples, seed)
    moments = _Moments()
    for each in examples:
        moments.add(
            features(settings, feature_map, each.speech, each.head), _gaze_windows(each.gaze, settings.context_frames)
        )
    found = moments.covariances()
    whiten_x = _power(_regularised(found.xx, settings.ridge), -0.5)
    of_y = _regularised(found.yy, settings.ridge)
    left, correlations, right = np.linalg.svd(whiten_x @ found.xy @ _power(of_y, -0.5), full_matrices=False)
    kept = slice(min(settings.canonical_components, len(correlations)))
    weights = whiten_x @ (left[:, kept] * correlations[kept]) @ right[kept] @ _power(of_y, 0.5)
    return CanonicalCorrelation(feature_map, moments.mean_x, weights, moments.mean_y, correlations[kept])


def generate_gaze(
    settings: CanonicalCorrelationSettings,
    found: CanonicalCorrelation,
    speech: Float[ndarray, "T C"],
    head: Float[ndarray, "T 3"],
) -> Float[ndarray, "T 2 3"]:
    """Eye-in-head rotation vectors for a standardised speech and a head."""
    lifted = features(settings, found.feature_map, speech, head)
    stretches = (found.offset + (lifted - found.centre) @ found.weights).reshape(len(head), -1, 6)
    reach, frames = settings.context_frames, len(head)
    total, count = np.zeros((frames, 6)), np.zeros((frames, 1))
    for at, ahead in enumerate(range(-reach, reach + 1)):
        said, meant = slice(max(0, -ahead), frames - max(0, ahead)), slice(max(0, ahead), frames - max(0, -ahead))
        total[meant] += stretches[said, at]
        count[meant] += 1
    return (total / count).reshape(frames, 2, 3)


def features(
    settings: CanonicalCorrelationSettings,
    feature_map: FeatureMap,
    speech: Float[ndarray, "T C"],
    head: Float[ndarray, "T 3"],
) -> Float[ndarray, "T X"]:
    """Lagged speech and head with their random Fourier features."""
    frame_features = (
        _lagged(_frame_features(feature_map.speech_basis, speech, head), settings.lags_frames) - feature_map.mean
    ) / feature_map.scale
    waves = np.sqrt(2.0) * np.cos(frame_features @ feature_map.frequencies + feature_map.phases)
    return np.concatenate([frame_features, waves], axis=1)


def _fit_feature_map(settings: CanonicalCorrelationSettings, examples: Sequence[Example], seed: int) -> FeatureMap:
    """Principal components of speech, spread of what is seen, and drawn frequencies."""
    moments = _Moments()
    for each in examples:
        moments.add(each.speech, each.speech[:, :1])
    variances, axes = np.linalg.eigh(moments.covariances().xx)
    basis = axes[:, np.argsort(-variances)[: settings.speech_components]]
    spread = _Moments()
    for each in examples:
        lagged = _lagged(_frame_features(basis, each.speech, each.head), settings.lags_frames)
        spread.add(lagged, lagged[:, :1])
    scale = np.sqrt(np.maximum(np.diag(spread.covariances().xx), 1e-12))
    rng = np.random.default_rng(seed)
    frequencies = rng.normal(size=(len(scale), settings.fourier_features)) / (
        settings.kernel_width * np.sqrt(len(scale))
    )
    return FeatureMap(basis, spread.mean_x, scale, frequencies, rng.uniform(0, 2 * np.pi, settings.fourier_features))


def _frame_features(
    basis: Float[ndarray, "C P"], speech: Float[ndarray, "T C"], head: Float[ndarray, "T 3"]
) -> Float[ndarray, "T S"]:
    """What is known of a frame: components of speech, the head and how it turns."""
    turning = np.diff(head, axis=0, prepend=head[:1])
    return np.concatenate([speech @ basis, head, turning], axis=1).astype(float)


def _lagged(values: Float[ndarray, "T S"], lags: Sequence[int]) -> Float[ndarray, "T D"]:
    """Values at several lags; the ends hold."""
    place = np.arange(len(values))
    return np.concatenate([values[np.clip(place + lag, 0, len(values) - 1)] for lag in lags], axis=1)


def _gaze_windows(gaze: Float[ndarray, "T 2 3"], reach: int) -> Float[ndarray, "T Y"]:
    """Each frame's gaze with those around it."""
    return _lagged(gaze.reshape(len(gaze), 6).astype(float), range(-reach, reach + 1))


def _regularised(covariance: Float[ndarray, "D D"], ridge: float) -> Float[ndarray, "D D"]:
    return np.asarray(covariance + ridge * np.trace(covariance) / len(covariance) * np.eye(len(covariance)))


def _power(matrix: Float[ndarray, "D D"], exponent: float) -> Float[ndarray, "D D"]:
    """A power of a symmetric matrix of positive eigenvalues."""
    values, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.maximum(values, 1e-12) ** exponent) @ axes.T)


@dataclass(frozen=True)
class _Covariances:
    xx: Float[ndarray, "X X"]
    xy: Float[ndarray, "X Y"]
    yy: Float[ndarray, "Y Y"]


class _Moments:
    """Sums of products of two sides, motion by motion, so that memory does not grow with the corpus."""

    def __init__(self) -> None:
        self.products: ndarray = np.zeros((0, 0))
        self.sums: ndarray = np.zeros(0)
        self.count, self.width = 0, 0

    def add(self, x: Float[ndarray, "T X"], y: Float[ndarray, "T Y"]) -> None:
        """Count a motion."""
        both = np.concatenate([x, y], axis=1).astype(float)
        if self.count == 0:
            self.products, self.sums, self.width = np.zeros((both.shape[1],) * 2), np.zeros(both.shape[1]), x.shape[1]
        self.products += both.T @ both
        self.sums += both.sum(0)
        self.count += len(both)

    @property
    def mean_x(self) -> Float[ndarray, " X"]:
        """Of the first side."""
        return self.sums[: self.width] / self.count

    @property
    def mean_y(self) -> Float[ndarray, " Y"]:
        """Of the second."""
        return self.sums[self.width :] / self.count

    def covariances(self) -> _Covariances:
        """Of both sides and between them."""
        mean, at = self.sums / self.count, self.width
        whole = self.products / self.count - np.outer(mean, mean)
        return _Covariances(whole[:at, :at], whole[:at, at:], whole[at:, at:])
