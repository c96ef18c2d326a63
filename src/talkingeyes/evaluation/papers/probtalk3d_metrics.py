"""Face metrics of one sound, and of all sounds of a row with intervals over sounds; emotion recognition.

Emotions are recognised by a classifier trained on true faces of the train split: linear discriminant analysis with a
shrunken covariance (Friedman 1989) and equal priors, on the mean and the SD over a clip of the positions of the
landmarks, in millimetres. Blend shape weights would not do: several shapes look alike, and a fit distributes the motion
among them. `SHRINKAGE` is the middle of the range (0.1 to 0.6) that works equally well on held-out speakers of the
train split.

The reference is the true motion, or fitted motion in a corpus without truth. MVE and LVE average over frames, the
others over sounds, as in the text of ProbTalk3D. The mean face has the best MVE and multi-sample errors, and a shut
mouth closes on every bilabial: read a row next to truth, fitted motion and baselines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.containers import read_npz
from talkingeyes.core.npz import save_npz
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    ClipStatistic,
    Estimate,
    MultiSeedEstimate,
    bootstrap,
    estimates_over_seeds,
    mean_statistic,
    nanmean_statistic,
    ratio_statistic,
)
from talkingeyes.evaluation.papers.probtalk3d_articulation import ArticulationMetrics, articulation
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.evaluation.papers.probtalk3d_vertices import VertexErrors, split_half_diversity, vertex_errors

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

    @classmethod
    def load(cls, path: Path) -> EmotionClassifier:
        """Read what `save` wrote. Raises InputError (one line)."""
        found = read_npz(path, {"emotions", "weights", "offsets"}, "classifier of the stage critic")
        return cls(tuple(map(str, found["emotions"])), found["weights"], found["offsets"])

    def save(self, path: Path) -> None:
        """Write the classifier as npz."""
        save_npz(path, emotions=np.array(self.emotions), weights=self.weights, offsets=self.offsets)

    def predict(self, feature_rows: Float[ndarray, "N F"]) -> list[str]:
        """Most likely emotion of each row."""
        best = (feature_rows @ self.weights.T + self.offsets).argmax(axis=1)
        return [self.emotions[kind] for kind in best]


def balanced_accuracy(hits: Float[ndarray, " N"], emotions: Sequence[str] | ndarray) -> float:
    """Hit rate of each emotion, averaged over emotions; chance is 1 / number of emotions."""
    kinds = np.asarray(emotions)
    return float(np.mean([hits[kinds == kind].mean() for kind in np.unique(kinds)]))


FRAME_AVERAGED = ("mve", "lve", "lve_squared")


@dataclass(frozen=True)
class FaceCase:
    """One sound.

    `includes_reference`: the samples are real takes of this sound and the first is the reference itself.
    """

    samples: FaceSamples
    includes_reference: bool
    truth: FaceSamples  # all takes
    valid: Bool[ndarray, " T"]
    annotation: Annotation
    sound: Float[ndarray, " N"]
    seed: tuple[int, ...]  # for the split into halves


@dataclass(frozen=True)
class FaceMetrics:
    """Metrics of one sound; `errors` is None if no sample can be compared. NaN where a metric is undefined."""

    errors: VertexErrors | None
    articulation: ArticulationMetrics
    diversity: float
    diversity_truth: float
    emotion: str
    accuracy: float  # fraction of samples with the right emotion recognised; NaN without a classifier


def face_metrics(surface: FaceSurface, classifier: EmotionClassifier | None, case: FaceCase) -> FaceMetrics:
    """Compute the metrics of one sound."""
    compared = range(int(case.includes_reference), len(case.samples.jaw))
    predicted = classifier.predict(emotion_features(surface, case.samples)) if classifier else []
    own = split_half_diversity(surface, case.samples, np.random.default_rng(case.seed))
    return FaceMetrics(
        errors=vertex_errors(surface, case.truth, case.samples, compared, case.valid) if compared else None,
        articulation=articulation(surface, case.samples, case.annotation, case.sound),
        diversity=own,
        diversity_truth=split_half_diversity(surface, case.truth, np.random.default_rng(case.seed)),
        emotion=case.annotation.emotion,
        accuracy=float(np.mean([each == case.annotation.emotion for each in predicted])) if predicted else float("nan"),
    )


def crop_faces(faces: FaceSamples, frames: int) -> FaceSamples:
    """The first `frames` frames of all samples."""
    jaw, expression = faces.jaw[:, :frames], faces.expression[:, :frames]
    return FaceSamples(faces.fps, jaw, expression, faces.expression_names, faces.head_model)


def summarise_face(sounds: Sequence[FaceMetrics], settings: BootstrapSettings) -> dict[str, Estimate]:
    """Metrics over sounds; one that no sound defines is left out. `diversity_ratio` is relative to the true takes."""
    found = _statistics(sounds)
    return {name: bootstrap(each, each.count, settings) for name, each in found.items()}


def summarise_seeds(
    seeds: Sequence[Sequence[FaceMetrics]], settings: BootstrapSettings
) -> dict[str, MultiSeedEstimate]:
    """Metrics of the same sounds under several seeds: mean, its interval over sounds, and range over seeds."""
    return estimates_over_seeds([_statistics(each) for each in seeds], settings)


def paired_differences(
    row: Sequence[Sequence[FaceMetrics]], other: Sequence[Sequence[FaceMetrics]], settings: BootstrapSettings
) -> dict[str, MultiSeedEstimate]:
    """Metrics of one row less those of another, under the same seeds and with resamples of the same sounds; without
    metrics that the rows define on different numbers of sounds."""
    by_seed = []
    for one, two in zip(row, other, strict=True):
        own, compared = _statistics(one), _statistics(two)
        shared = [name for name in own if name in compared and own[name].count == compared[name].count]
        by_seed.append({name: _difference(own[name], compared[name]) for name in shared})
    return estimates_over_seeds(by_seed, settings)


def _difference(one: ClipStatistic, other: ClipStatistic) -> ClipStatistic:
    return ClipStatistic(lambda sounds: one(sounds) - other(sounds), one.count)


def _statistics(sounds: Sequence[FaceMetrics]) -> dict[str, ClipStatistic]:
    """Every metric that at least one sound defines."""
    errors = [each.errors for each in sounds if each.errors is not None]
    frames = np.array([each.frames for each in errors], float)
    found: dict[str, ClipStatistic] = {}
    for name in (field.name for field in fields(VertexErrors) if field.name != "frames"):
        values = np.array([getattr(each, name) for each in errors])
        found[name] = ClipStatistic(
            ratio_statistic(values * frames, frames) if name in FRAME_AVERAGED else mean_statistic(values), len(values)
        )
    for name in (field.name for field in fields(ArticulationMetrics)):
        found[name] = nanmean_statistic(np.array([getattr(each.articulation, name) for each in sounds]))
    own, truth = (np.array([getattr(each, name) for each in sounds]) for name in ("diversity", "diversity_truth"))
    several = ~np.isnan(own + truth)
    found["diversity"] = nanmean_statistic(own)
    if truth[several].all():
        found["diversity_ratio"] = ClipStatistic(ratio_statistic(own[several], truth[several]), int(several.sum()))
    known = [each for each in sounds if not np.isnan(each.accuracy)]
    accuracy, emotions = np.array([each.accuracy for each in known]), np.array([each.emotion for each in known])
    found["emotion_accuracy"] = ClipStatistic(
        lambda resampled: balanced_accuracy(accuracy[resampled], emotions[resampled]), len(known)
    )
    return {name: each for name, each in found.items() if each.count}
