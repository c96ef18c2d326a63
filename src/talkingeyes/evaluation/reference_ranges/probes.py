"""How far motion can be told from sound, and how far takes of one sound differ: probes of the one-to-many link.

Ridge regression from speech features to angles and to the gaze state, always tested on speakers that it was not fitted
to; Gram matrices a speaker are all that is kept, so memory does not grow with the corpus. Shares of variance that a new
draw makes, over the takes of one sound. Intraclass correlation of styles between the two halves of a speaker's clips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, PooledArrays, measurement

LAGS_S = tuple(np.round(np.arange(-2.0, 2.01, 0.4), 1))
SEGMENT_S = 30.0
# Of the targets: (yaw, pitch) of the eyes, pitch of the head, last whether gaze is averted. What prosody moves are nods
# (Munhall et al. 2004); yaw and roll of the head cannot be told from sound at all, and would only thin the figure.
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
        """Of ridge regression; `ridge` is a share of the number of frames, on features of unit variance."""
        return np.asarray(np.linalg.solve(self.xx + ridge * self.frames * np.eye(len(self.xx)), self.xy))

    def residual_squares(self, weights: Float[ndarray, "F K"]) -> Float[ndarray, " K"]:
        """Squares that weights leave of each target."""
        return np.asarray(self.yy - 2 * (weights * self.xy).sum(axis=0) + (weights * (self.xx @ weights)).sum(axis=0))


def fit_ridge(speakers: Sequence[GramMatrices]) -> Float[ndarray, "F K"]:
    """Weights from some speakers, each target with the ridge that every other of them bears out on the rest.

    Head and gaze drift for seconds, so an hour holds a few hundred independent moments: without a choice, three hundred
    features are learnt by heart and R2 on others is below 0.
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
    """Features of each frame, with the channels of prosody from two seconds before to two after, and a constant."""
    frames = np.arange(len(speech))
    around = [speech[np.clip(frames + round(lag * fps), 0, len(speech) - 1)][:, list(prosody)] for lag in LAGS_S if lag]
    return np.concatenate([speech, *around, np.ones((len(speech), 1))], axis=1)


def gram(features: Float[ndarray, "T F"], targets: Float[ndarray, "T K"]) -> GramMatrices:
    """Of the frames of a clip."""
    return GramMatrices(features.T @ features, features.T @ targets, np.square(targets).sum(axis=0), len(features))


@dataclass(frozen=True)
class ProbeScore:
    """What weights of other speakers tell of one: squares left and there of each target, AUC of the last."""

    residual_squares: Float[ndarray, " K"]
    total: Float[ndarray, " K"]
    auc: float
    frames: int


def score_probe(
    features: Float[ndarray, "T F"], targets: Float[ndarray, "T K"], weights: Float[ndarray, "F K"]
) -> ProbeScore:
    """Test a probe on the frames of a speaker; the last target is a flag, of which the order of scores counts."""
    guess = features @ weights
    residual_squares, total = np.square(targets - guess).sum(axis=0), np.square(targets).sum(axis=0)
    return ProbeScore(residual_squares, total, auc(guess[:, -1], targets[:, -1] > targets[:, -1].mean()), len(features))


def measure_probes(found: Sequence[ProbeScore]) -> dict[str, Measurement]:
    """R2 of eye angles and of head pitch about the clip's mean, and mean AUC of the averted state within speakers."""
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
    """R2 of several targets together: 1 - squares left / squares there."""
    return float(1 - residual_squares.sum() / max(float(total.sum()), 1e-12))


def auc(score: Float[ndarray, " N"], flag: Bool[ndarray, " N"]) -> float:
    """Chance that a flagged frame scores above another."""
    order = np.argsort(score, kind="stable")
    rank = np.empty(len(order))
    rank[order] = np.arange(1, len(order) + 1)
    count, rest = int(flag.sum()), int((~flag).sum())
    if not count or not rest:
        return float("nan")
    return float((rank[flag].sum() - count * (count + 1) / 2) / (count * rest))


def between_take_variance(takes: Float[ndarray, "S T C"]) -> Float[ndarray, " 2"]:
    """Variance between takes and variance in all, of one sound: sums over frames and channels.

    Between takes is what a new draw adds at a frame; shared is the rest of the variance of the mean course over time.
    """
    count = len(takes)
    between = float(takes.var(axis=0, ddof=1).mean(axis=0).sum())
    course = float(takes.mean(axis=0).var(axis=0).sum())
    return np.array([between, between + max(course - between / count, 0.0)])


def between_take_fraction(pool: PooledArrays, part: str) -> Measurement:
    """Share of the variance that a new draw makes, over the sounds that have several takes."""
    found = pool.get(f"takes.{part}", np.zeros((0, 2)))
    between, total = found.sum(axis=0)
    return measurement(between / max(total, 1e-15), len(found), "sounds with several takes", 3)


def intraclass_correlation(groups: Sequence[Float[ndarray, " _"]]) -> float:
    """ICC(1): share of the variance of single measurements that lies between people (one-way, unequal counts)."""
    counts = np.array([len(each) for each in groups], float)
    total, people = counts.sum(), len(groups)
    means = np.array([each.mean() for each in groups])
    between = float(counts @ np.square(means - (counts @ means) / total)) / (people - 1)
    inside = sum(float(np.square(each - each.mean()).sum()) for each in groups) / (total - people)
    usual = (total - np.square(counts).sum() / total) / (people - 1)
    return float((between - inside) / max(between + (usual - 1) * inside, 1e-12))


def style_icc(pool: PooledArrays, what: str) -> Measurement:
    """ICC of half minutes of a speaker: clips one after another until they make one."""
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
