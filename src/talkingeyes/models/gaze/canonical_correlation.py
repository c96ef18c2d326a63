"""Gaze from head motion and speech by canonical correlation, an early method that TalkingEyes compares itself with.

Le, Ma and Deng, "Live Speech Driven Head-and-Eye Motion Generators" (TVCG 2012) relate gaze to head motion and speech
features by non-linear dynamical canonical correlation analysis. TalkingEyes compares with it in a video only. Their
program is not public. This is not a reimplementation, but the same idea in closed form:

- non-linear: speech and head motion are mapped to random Fourier features of a Gaussian kernel (Rahimi and Recht 2007),
  which keeps the memory linear in the number of frames, where kernel matrices are quadratic;
- dynamical: both sides are windows, speech and head at several lags against a window of gaze; overlapping windows are
  averaged.

The strongest canonical components give gaze by reduced-rank regression. The result is deterministic: gaze differs
between samples only through the head, which another model generates.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from pydantic import Field

from talkingeyes.core.settings import Settings


class CanonicalCorrelationSettings(Settings):
    """Settings of the canonical correlation analysis."""

    # Principal components of the speech features.
    speech_components: Annotated[int, Field(gt=0)]
    # Lags of speech and head in frames; negative: before the frame.
    lags_frames: tuple[int, ...] = Field(min_length=1)
    # Half width of a gaze window: frames before and after the centre.
    context_frames: Annotated[int, Field(ge=0)]
    # Number of random Fourier features, and the kernel width in standard deviations of the inputs.
    fourier_features: Annotated[int, Field(gt=0)]
    kernel_width: Annotated[float, Field(gt=0)]
    # Number of canonical components.
    canonical_components: Annotated[int, Field(gt=0)]
    # Ridge added to both covariances, as a fraction of the mean variance.
    ridge: Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class Example:
    """A training motion with standardised speech features."""

    speech: Float[ndarray, "T C"]
    head: Float[ndarray, "T 3"]
    gaze: Float[ndarray, "T 2 3"]


@dataclass(frozen=True)
class FeatureMap:
    """Map from speech and head to the features of the regression."""

    speech_basis: Float[ndarray, "C P"]
    mean: Float[ndarray, " D"]
    scale: Float[ndarray, " D"]
    frequencies: Float[ndarray, "D F"]
    phases: Float[ndarray, " F"]


@dataclass(frozen=True)
class CanonicalCorrelation:
    """The fitted regression: gaze windows are `offset + (features - centre) @ weights`."""

    feature_map: FeatureMap
    centre: Float[ndarray, " X"]
    weights: Float[ndarray, "X Y"]
    offset: Float[ndarray, " Y"]
    correlations: Float[ndarray, " K"]  # canonical correlations of the kept components


def fit_canonical_correlation(
    settings: CanonicalCorrelationSettings, examples: Sequence[Example], seed: int
) -> CanonicalCorrelation:
    """Fit the regression to training motions, processed one at a time."""
    feature_map = _fit_feature_map(settings, examples, seed)
    mean, covariance = _moments(
        np.concatenate(
            [
                random_features(settings, feature_map, each.speech, each.head),
                _gaze_windows(each.gaze, settings.context_frames),
            ],
            axis=1,
        )
        for each in examples
    )
    features = len(feature_map.scale) + settings.fourier_features
    x, y = slice(features), slice(features, None)
    whiten_x = _power(_regularised(covariance[x, x], settings.ridge), -0.5)
    of_y = _regularised(covariance[y, y], settings.ridge)
    left, correlations, right = np.linalg.svd(whiten_x @ covariance[x, y] @ _power(of_y, -0.5), full_matrices=False)
    kept = slice(min(settings.canonical_components, len(correlations)))
    weights = whiten_x @ (left[:, kept] * correlations[kept]) @ right[kept] @ _power(of_y, 0.5)
    return CanonicalCorrelation(feature_map, mean[x], weights, mean[y], correlations[kept])


def generate_gaze(
    settings: CanonicalCorrelationSettings,
    found: CanonicalCorrelation,
    speech: Float[ndarray, "T C"],
    head: Float[ndarray, "T 3"],
) -> Float[ndarray, "T 2 3"]:
    """Generate eye-in-head rotation vectors for standardised speech features and a head motion."""
    lifted = random_features(settings, found.feature_map, speech, head)
    stretches = (found.offset + (lifted - found.centre) @ found.weights).reshape(len(head), -1, 6)
    reach, frames = settings.context_frames, len(head)
    total, count = np.zeros((frames, 6)), np.zeros((frames, 1))
    for at, ahead in enumerate(range(-reach, reach + 1)):
        said, meant = slice(max(0, -ahead), frames - max(0, ahead)), slice(max(0, ahead), frames - max(0, -ahead))
        total[meant] += stretches[said, at]
        count[meant] += 1
    return (total / count).reshape(frames, 2, 3)


def random_features(
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
    """Principal components of speech, mean and scale of the lagged inputs, and random frequencies."""
    variances, axes = np.linalg.eigh(_moments(each.speech for each in examples)[1])
    basis = axes[:, np.argsort(-variances)[: settings.speech_components]]
    mean, covariance = _moments(
        _lagged(_frame_features(basis, each.speech, each.head), settings.lags_frames) for each in examples
    )
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-12))
    rng = np.random.default_rng(seed)
    frequencies = rng.normal(size=(len(scale), settings.fourier_features)) / (
        settings.kernel_width * np.sqrt(len(scale))
    )
    return FeatureMap(basis, mean, scale, frequencies, rng.uniform(0, 2 * np.pi, settings.fourier_features))


def _frame_features(
    basis: Float[ndarray, "C P"], speech: Float[ndarray, "T C"], head: Float[ndarray, "T 3"]
) -> Float[ndarray, "T S"]:
    """Inputs per frame: components of speech, head rotation and its change."""
    turning = np.diff(head, axis=0, prepend=head[:1])
    return np.concatenate([speech @ basis, head, turning], axis=1).astype(float)


def _lagged(values: Float[ndarray, "T S"], lags: Sequence[int]) -> Float[ndarray, "T D"]:
    """Values at several lags; the first and last values are repeated."""
    place = np.arange(len(values))
    return np.concatenate([values[np.clip(place + lag, 0, len(values) - 1)] for lag in lags], axis=1)


def _gaze_windows(gaze: Float[ndarray, "T 2 3"], reach: int) -> Float[ndarray, "T Y"]:
    """A window of gaze around each frame."""
    return _lagged(gaze.reshape(len(gaze), 6).astype(float), range(-reach, reach + 1))


def _regularised(covariance: Float[ndarray, "D D"], ridge: float) -> Float[ndarray, "D D"]:
    return np.asarray(covariance + ridge * np.trace(covariance) / len(covariance) * np.eye(len(covariance)))


def _power(matrix: Float[ndarray, "D D"], exponent: float) -> Float[ndarray, "D D"]:
    """Power of a symmetric positive definite matrix."""
    values, axes = np.linalg.eigh(matrix)
    return np.asarray((axes * np.maximum(values, 1e-12) ** exponent) @ axes.T)


def _moments(rows: Iterable[Float[ndarray, "_ D"]]) -> tuple[Float[ndarray, " D"], Float[ndarray, "D D"]]:
    """Mean and covariance of rows that come a motion at a time, so that memory does not grow with the corpus."""
    products: ndarray | float = 0.0
    sums: ndarray | float = 0.0
    count = 0
    for each in rows:
        whole = each.astype(float)
        products = products + whole.T @ whole
        sums = sums + whole.sum(0)
        count += len(whole)
    mean = np.asarray(sums / count)
    return mean, np.asarray(products / count - np.outer(mean, mean))
