"""Probes of the one-to-many relation of sound and motion.

- Ridge regression from speech features to angles and gaze state, always tested on speakers outside the fit. Only the
  Gram matrices of each speaker are kept, so memory does not grow with the corpus.
- Fraction of the variance that lies between takes of the same sound.
- Intraclass correlation of style over segments of half a minute of each speaker.
- Discrimination of the matched sound from other sounds of the same speaker, over windows of 8 s.

For the last, the critic's two towers (evaluation/measures/critic.py) are trained on the true motion of the train split
(gaze in space, head, jaw) and tested on unseen sounds and speakers. Gaze and head are combined by the sum of their
similarities. p is the rank of the mean similarity of matched pairs among random pairings within each speaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.measures.critic import ChannelSelection, CriticSettings, auc, first_windows, train_critic
from talkingeyes.evaluation.measures.pooled import Measurement, PooledArrays, measurement
from talkingeyes.models.contrastive_critic import similarity

LAGS_S = tuple(np.round(np.arange(-2.0, 2.01, 0.4), 1))
SEGMENT_S = 30.0
# Indices of the targets: (yaw, pitch) of the eyes, pitch of the head; the last is the averted state. Prosody correlates
# with nods (Munhall et al. 2004); yaw and roll of the head cannot be predicted from sound and would only dilute R2.
EYE, HEAD = slice(0, 2), slice(2, 3)
RIDGE_STRENGTHS = (0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class GramMatrices:
    """Sums of products of features X and targets Y over the frames of one speaker."""

    xx: Float[ndarray, "F F"]
    xy: Float[ndarray, "F K"]
    yy: Float[ndarray, " K"]
    frames: int

    def __add__(self, other: GramMatrices) -> GramMatrices:
        return GramMatrices(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy, self.frames + other.frames)

    def weights(self, ridge: float) -> Float[ndarray, "F K"]:
        """Weights of ridge regression; `ridge` is a multiple of the number of frames, for features of unit variance."""
        return np.asarray(np.linalg.solve(self.xx + ridge * self.frames * np.eye(len(self.xx)), self.xy))

    def residual_squares(self, weights: Float[ndarray, "F K"]) -> Float[ndarray, " K"]:
        """Residual sum of squares of each target."""
        return np.asarray(self.yy - 2 * (weights * self.xy).sum(axis=0) + (weights * (self.xx @ weights)).sum(axis=0))


def fit_ridge(speakers: Sequence[GramMatrices]) -> Float[ndarray, "F K"]:
    """Ridge weights from several speakers; the ridge strength of each target is chosen by two-fold cross-validation.

    Head and gaze are correlated over seconds, so an hour has only a few hundred independent frames. Without
    regularisation three hundred features overfit, and R2 on other speakers is below 0.
    """
    one, other = (sum(half[1:], half[0]) for half in (speakers[::2], speakers[1::2]))
    residual_squares = np.stack(
        [
            other.residual_squares(one.weights(ridge)) + one.residual_squares(other.weights(ridge))
            for ridge in RIDGE_STRENGTHS
        ]
    )
    whole = one + other
    each = np.stack([whole.weights(ridge) for ridge in RIDGE_STRENGTHS])
    return np.asarray(each[residual_squares.argmin(axis=0), :, np.arange(residual_squares.shape[1])].T)


def with_context(speech: Float[ndarray, "T C"], prosody: Sequence[int], fps: float) -> Float[ndarray, "T F"]:
    """Features of each frame, with the prosody channels from 2 s before to 2 s after, and a constant."""
    frames = np.arange(len(speech))
    around = [speech[np.clip(frames + round(lag * fps), 0, len(speech) - 1)][:, list(prosody)] for lag in LAGS_S if lag]
    return np.concatenate([speech, *around, np.ones((len(speech), 1))], axis=1)


def gram_matrices(features: Float[ndarray, "T F"], targets: Float[ndarray, "T K"]) -> GramMatrices:
    """Gram matrices of the frames of a clip."""
    return GramMatrices(features.T @ features, features.T @ targets, np.square(targets).sum(axis=0), len(features))


@dataclass(frozen=True)
class ProbeScore:
    """Test of weights on one speaker: residual and total sum of squares of each target, and AUC of the last."""

    residual_squares: Float[ndarray, " K"]
    total: Float[ndarray, " K"]
    auc: float
    frames: int


def score_probe(
    features: Float[ndarray, "T F"], targets: Float[ndarray, "T K"], weights: Float[ndarray, "F K"]
) -> ProbeScore:
    """Test a probe on the frames of a speaker; the last target is binary and scored by AUC."""
    guess = features @ weights
    residual_squares, total = np.square(targets - guess).sum(axis=0), np.square(targets).sum(axis=0)
    return ProbeScore(
        residual_squares, total, _frame_auc(guess[:, -1], targets[:, -1] > targets[:, -1].mean()), len(features)
    )


def measure_probes(found: Sequence[ProbeScore]) -> dict[str, Measurement]:
    """R2 of eye angles and head pitch about the mean of the clip, and mean over speakers of the AUC of aversion."""
    frames = sum(each.frames for each in found)
    residual_squares, total = (
        np.sum([getattr(each, name) for each in found], axis=0) for name in ("residual_squares", "total")
    )
    areas = [each.auc for each in found if np.isfinite(each.auc)]
    return {
        "eye_r2": measurement(r_squared(residual_squares[EYE], total[EYE]), frames, "frames", 1500),
        "head_r2": measurement(r_squared(residual_squares[HEAD], total[HEAD]), frames, "frames", 1500),
        "averted_auc": measurement(float(np.mean(areas)) if areas else np.nan, len(areas), "speakers", 3),
    }


def r_squared(residual_squares: Float[ndarray, " K"], total: Float[ndarray, " K"]) -> float:
    """R2 of several targets together: 1 - residual / total sum of squares."""
    return float(1 - residual_squares.sum() / max(float(total.sum()), 1e-12))


def _frame_auc(score: Float[ndarray, " N"], flag: Bool[ndarray, " N"]) -> float:
    """Probability that a flagged frame scores higher than another; NaN without both kinds."""
    order = np.argsort(score, kind="stable")
    rank = np.empty(len(order))
    rank[order] = np.arange(1, len(order) + 1)
    count, rest = int(flag.sum()), int((~flag).sum())
    if not count or not rest:
        return float("nan")
    return float((rank[flag].sum() - count * (count + 1) / 2) / (count * rest))


def between_take_variance(takes: Float[ndarray, "S T C"]) -> Float[ndarray, " 2"]:
    """Variance between takes of one sound and total variance, averaged over frames and summed over channels.

    The total adds the shared variance: that of the mean trajectory over time, less the part due to the finite number
    of takes.
    """
    count = len(takes)
    between = float(takes.var(axis=0, ddof=1).mean(axis=0).sum())
    course = float(takes.mean(axis=0).var(axis=0).sum())
    return np.array([between, between + max(course - between / count, 0.0)])


def between_take_fraction(pool: PooledArrays, part: str) -> Measurement:
    """Fraction of the variance that lies between takes, over the sounds with several takes."""
    found = pool.get(f"takes.{part}", np.zeros((0, 2)))
    between, total = found.sum(axis=0)
    return measurement(between / max(total, 1e-15), len(found), "sounds with several takes", 3)


def intraclass_correlation(groups: Sequence[Float[ndarray, " _"]]) -> float:
    """ICC(1): fraction of the variance of single measurements that lies between people (one-way, unequal counts)."""
    counts = np.array([len(each) for each in groups], float)
    total, people = counts.sum(), len(groups)
    means = np.array([each.mean() for each in groups])
    between = float(counts @ np.square(means - (counts @ means) / total)) / (people - 1)
    inside = sum(float(np.square(each - each.mean()).sum()) for each in groups) / (total - people)
    usual = (total - np.square(counts).sum() / total) / (people - 1)
    return float((between - inside) / max(between + (usual - 1) * inside, 1e-12))


def style_icc(pool: PooledArrays, what: str) -> Measurement:
    """ICC of segments of half a minute, made from consecutive clips of a speaker."""
    speakers, values, seconds = pool["style.speaker"], pool[f"style.{what}"], pool["style.s"]
    groups = []
    for speaker in np.unique(speakers):
        mine = speakers == speaker
        stretch = np.floor(np.cumsum(seconds[mine]) / SEGMENT_S - 1e-9).astype(int)
        whole = [each for each in np.unique(stretch) if seconds[mine][stretch == each].sum() >= 0.6 * SEGMENT_S]
        if len(whole) > 1:
            groups.append(
                np.array([values[mine][stretch == each].sum() / seconds[mine][stretch == each].sum() for each in whole])
            )
    return measurement(intraclass_correlation(groups) if len(groups) > 2 else np.nan, len(groups), "speakers", 8)


PERMUTATIONS = 999
MIN_WINDOWS = 20


@dataclass(frozen=True)
class SimilarityMatrix:
    """Similarity of every sound with every motion, and mask of the pairs of one speaker with different sounds."""

    cosine: Float[ndarray, "N N"]
    negatives: Bool[ndarray, "N N"]

    def __add__(self, other: SimilarityMatrix) -> SimilarityMatrix:
        """Sum of both similarities, each divided by its standard deviation."""
        return SimilarityMatrix(self.cosine / self.cosine.std() + other.cosine / other.cosine.std(), self.negatives)


def train_similarity(
    part: str,
    train: Sequence[Recording],
    judged: Sequence[Recording],
    channel_selection: ChannelSelection,
    settings: CriticSettings,
) -> SimilarityMatrix:
    """Train a critic on `train` and compute the similarity of all pairs of recordings in `judged`."""
    trained = train_critic(part, train, channel_selection, settings).corr
    group = first_windows(judged, part, trained.critic.speech_channels.numpy(), trained.frames)
    with torch.no_grad():
        found = similarity(trained.critic.speech(group.speech_features), trained.critic.motion(group.angles))
    return SimilarityMatrix(found.numpy().astype(np.float64), group.negatives)


def matching_auc(similar: SimilarityMatrix) -> Measurement:
    """AUC of matched pairs against mismatched pairs of the same speaker."""
    known = similar.negatives.any(axis=1)
    right = np.diag(similar.cosine)[known]
    return measurement(float(auc(right, similar.cosine[similar.negatives])), int(known.sum()), "windows", MIN_WINDOWS)


def permutation_p_value(similar: SimilarityMatrix, seed: int) -> Measurement:
    """p value of the mean similarity of matched pairs, by permutation within speakers."""
    rng, count = np.random.default_rng(seed), len(similar.cosine)
    same = similar.negatives | np.eye(count, dtype=bool)
    groups = [np.flatnonzero(row) for index, row in enumerate(same) if np.flatnonzero(row)[0] == index]
    right, above = np.diag(similar.cosine).mean(), 0
    for _ in range(PERMUTATIONS):
        order = np.arange(count)
        for group in groups:
            order[group] = rng.permutation(group)
        above += similar.cosine[np.arange(count), order].mean() >= right
    return measurement((1 + above) / (1 + PERMUTATIONS), count, "windows", MIN_WINDOWS)
