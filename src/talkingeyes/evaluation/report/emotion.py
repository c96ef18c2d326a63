"""Emotion recognised from head and gaze alone, without the face.

The classifier is that of faces (evaluation/papers/probtalk3d_metrics.py), on posture, range and speed of the head, and
place, range, speed and lowering of gaze over a clip. It is trained on real motion of the train split. Emotions count
equally; chance is 1 of their number, which motion that knows nothing of the emotion reaches. Emotions change the voice
too, so motion that only follows the sound can be above chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core import rotation
from talkingeyes.core.kinematics import gaze_in_space_speed_deg_s, head_speed_deg_s
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.bootstrap import BootstrapSettings, SoundStatistic, TableEstimate, estimate
from talkingeyes.evaluation.papers.probtalk3d_metrics import EmotionClassifier, balanced_accuracy

EMOTION_FILE = "emotion.npz"  # the classifier, in the output folder of the stage `critic`
SACCADE_DEG_S = 30.0  # speed of gaze from which a frame counts as part of a shift
# Added before logarithms: motion below these does not show. Degrees, degrees per second, fraction of frames.
LEAST_DEG, LEAST_DEG_S, LEAST_SHARE = 0.1, 0.5, 0.005


def head_gaze_features(samples: Samples) -> Float[ndarray, "S F"]:
    """Features of each motion over the clip, in degrees and logarithms."""
    head_deg = np.degrees(samples.head)
    gaze_deg = np.degrees(rotation.cyclopean_gaze(rotation.gaze_in_space(samples.head, samples.gaze)))
    eyes_deg = np.degrees(rotation.cyclopean_gaze(rotation.gaze_to_angles(samples.gaze)))
    away_deg = np.linalg.norm(gaze_deg - np.median(gaze_deg, axis=1, keepdims=True), axis=-1)
    head_deg_s, gaze_deg_s = (
        head_speed_deg_s(samples.head, samples.fps),
        gaze_in_space_speed_deg_s(samples.head, samples.gaze, samples.fps),
    )
    columns = [
        head_deg.mean(axis=1),
        np.log(head_deg.std(axis=1) + LEAST_DEG),
        np.log(np.quantile(head_deg_s, (0.5, 0.9), axis=1) + LEAST_DEG_S).T,
        np.quantile(gaze_deg[..., 1], (0.1, 0.5, 0.9), axis=1).T,
        np.quantile(eyes_deg[..., 1], (0.1, 0.5, 0.9), axis=1).T,
        np.log(gaze_deg.std(axis=1) + LEAST_DEG),
        np.log(np.quantile(away_deg, (0.5, 0.9), axis=1) + LEAST_DEG).T,
        np.log((gaze_deg_s > SACCADE_DEG_S).mean(axis=1) + LEAST_SHARE)[:, None],
    ]
    return np.concatenate(columns, axis=1)


def fit_classifier(feature_rows: Float[ndarray, "N F"], emotions: Sequence[str]) -> EmotionClassifier:
    """The classifier, fitted to features in standard deviations of the N clips; at least two emotions must occur."""
    scale = np.maximum(feature_rows.std(axis=0), 1e-6)
    classifier = EmotionClassifier.fit(feature_rows / scale, emotions)
    return replace(classifier, weights=classifier.weights / scale)


@dataclass(frozen=True)
class EmotionalSound:
    """A sound with its emotion, and the features of its motions."""

    speaker: str
    emotion: str
    features: Float[ndarray, "S F"]


def emotion_recognised(
    classifier: EmotionClassifier, sounds: Sequence[EmotionalSound], settings: BootstrapSettings
) -> TableEstimate:
    """Fraction of motions whose emotion is recognised, mean over emotions, with intervals over sounds and speakers."""
    emotions = np.array([each.emotion for each in sounds])
    shares = np.array(
        [np.mean([found == each.emotion for found in classifier.predict(each.features)]) for each in sounds]
    )
    statistic = SoundStatistic(
        lambda chosen: balanced_accuracy(shares[chosen], emotions[chosen]), tuple(each.speaker for each in sounds)
    )
    return estimate(statistic, settings)
