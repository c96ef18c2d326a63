"""Two-sample test: a classifier that sees sequences of ten fixations, generated or recorded (Lopez-Paz & Oquab 2017).

The features describe a sequence relative to the home of its person: where the fixations are, how long they last, how
far and in which direction the steps go, how often they cross to and from the partner and return to a previous place.
The classifier (gradient boosting of scikit-learn) is trained on some people and speakers and scores sequences of
others; people, and speakers, weigh the same whatever their length. AUC 0.5: indistinguishable from people; 1: always
recognised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.gaze_datasets import CONVERSATION_RATE_HZ
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, percentile_interval
from talkingeyes.evaluation.detectors.gaze_states import RADIUS_DEG
from talkingeyes.evaluation.people.fixations import Person

LENGTH = 10
FEATURES = 21
FOLDS = 4
MIN_SEQUENCES = 20  # of each class
SPLITS = 5  # random halves of the people for the reference


@dataclass(frozen=True)
class Sequences:
    """N sequences by their features, with the index of the person of each."""

    features: Float[ndarray, "N F"]
    owner: Int[ndarray, " N"]


def sequences_of(people: Sequence[Person], state: str) -> Sequences:
    """Cut the fixations of each person into sequences of LENGTH, across the cuts between segments."""
    features, owner = [], []
    for index, person in enumerate(people):
        record = person.records[state]
        place = record.centre_deg - person.home_deg
        for start in range(0, len(record) - LENGTH + 1, LENGTH):
            window = slice(start, start + LENGTH)
            samples = np.rint(record.duration_s[window] * CONVERSATION_RATE_HZ)  # both kinds on the same grid
            features.append(_features(place[window], samples, record.segment[window]))
            owner.append(index)
    return Sequences(np.array(features).reshape(len(owner), FEATURES), np.array(owner, int))


def _features(
    place: Float[ndarray, "L 2"], samples: Float[ndarray, " L"], segment: Int[ndarray, " L"]
) -> Float[ndarray, " F"]:
    away = np.hypot(*place.T) > RADIUS_DEG
    step = np.diff(place, axis=0)[segment[1:] == segment[:-1]]
    size = np.hypot(*step.T) if len(step) else np.full(1, np.nan)
    level = (np.abs(step[:, 0]) > np.abs(step[:, 1])).mean() if len(step) else np.nan
    back = np.hypot(*(place[2:] - place[:-2]).T)
    return np.array(
        [
            *place.mean(axis=0),
            *place.std(axis=0),
            *place.min(axis=0),
            *place.max(axis=0),
            *np.quantile(np.log(samples), [0, 0.25, 0.5, 0.75, 1]),
            *np.quantile(size, [0, 0.5, 1]),
            level,
            samples[away].sum() / samples.sum(),
            (away[1:] != away[:-1]).sum(),
            np.median(back),
            back.min(),
        ]
    )


def two_sample_auc(people: Sequences, speakers: Sequences, settings: BootstrapSettings) -> Estimate:
    """AUC on people and speakers that the classifier has not seen, with its interval over people and speakers.

    Raises InputError where either has too few people or sequences, or scikit-learn is not installed.
    """
    if min(len(people.owner), len(speakers.owner)) < MIN_SEQUENCES:
        raise InputError(
            f"two-sample test: needs {MIN_SEQUENCES} sequences of {LENGTH} fixations, got {len(people.owner)} of people"
            f" and {len(speakers.owner)} of speakers"
        )
    if min(len(np.unique(each.owner)) for each in (people, speakers)) < FOLDS:
        raise InputError(f"two-sample test: needs {FOLDS} people and speakers with enough fixations, got fewer")
    scores = [np.empty(len(each.owner)) for each in (people, speakers)]
    folds = [_folds(each.owner, settings.seed) for each in (people, speakers)]
    for fold in range(FOLDS):
        seen = [each != fold for each in folds]
        features = np.concatenate([each.features[kept] for each, kept in zip((people, speakers), seen, strict=True)])
        weight = np.concatenate(
            [_weights(each.owner[kept]) for each, kept in zip((people, speakers), seen, strict=True)]
        )
        label = np.repeat([0, 1], [kept.sum() for kept in seen])
        model = _fit(features, label, weight, settings.seed)
        for score, each, kept in zip(scores, (people, speakers), seen, strict=True):
            score[~kept] = model.predict_proba(each.features[~kept])[:, 1]
    rng = np.random.default_rng(settings.seed)
    counts = [int(each.owner.max()) + 1 for each in (people, speakers)]
    weights = [_weights(each.owner) for each in (people, speakers)]
    resampled = []
    for _ in range(settings.n_resamples):
        times = [np.bincount(rng.integers(count, size=count), minlength=count) for count in counts]
        drawn = [
            weight * each[sequences.owner]
            for weight, each, sequences in zip(weights, times, (people, speakers), strict=True)
        ]
        resampled.append(_auc(scores[0], scores[1], *drawn))
    return Estimate(_auc(scores[0], scores[1], *weights), *percentile_interval(np.array(resampled), settings))


def reference_auc(people: Sequences, settings: BootstrapSettings) -> Estimate:
    """AUC of people against other people: mean, least and largest over random halves of the people."""
    rng, count = np.random.default_rng(settings.seed), int(people.owner.max(initial=-1)) + 1
    once = settings.model_copy(update={"n_resamples": 20})
    found = []
    for _ in range(SPLITS):
        half = np.isin(people.owner, rng.permutation(count)[: count // 2])
        one, other = (Sequences(people.features[kept], _renumbered(people.owner[kept])) for kept in (half, ~half))
        found.append(two_sample_auc(one, other, once).value)
    return Estimate(float(np.mean(found)), float(np.min(found)), float(np.max(found)))


def each_its_own(sequences: Sequences) -> Sequences:
    """Sequences of pooled speakers, each counted as a person of its own."""
    return Sequences(sequences.features, np.arange(len(sequences.owner)))


def _renumbered(owner: Int[ndarray, " N"]) -> Int[ndarray, " N"]:
    return np.asarray(np.unique(owner, return_inverse=True)[1])


def _folds(owner: Int[ndarray, " N"], seed: int) -> Int[ndarray, " N"]:
    """The fold of each sequence; all sequences of a person are in one."""
    count = int(owner.max()) + 1
    return np.asarray((np.random.default_rng([seed, count]).permutation(count) % FOLDS)[owner])


def _weights(owner: Int[ndarray, " N"]) -> Float[ndarray, " N"]:
    """Weights under which every person weighs the same, with mean 1."""
    count = np.bincount(owner)[owner]
    return np.asarray(len(owner) / count / len(np.unique(owner)))


def _fit(features: ndarray, label: ndarray, weight: ndarray, seed: int) -> Any:
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
    except ImportError:
        raise InputError("two-sample test: needs scikit-learn (pip install 'talkingeyes[platform]')") from None
    balance = np.array([weight[label == each].sum() for each in (0, 1)])
    model = HistGradientBoostingClassifier(max_iter=50, learning_rate=0.1, max_leaf_nodes=8, random_state=seed)
    return model.fit(features, label, sample_weight=weight / balance[label] * len(label) / 2)


def _auc(low: ndarray, high: ndarray, low_weight: ndarray, high_weight: ndarray) -> float:
    """Weighted probability that a score of `high` is above one of `low`."""
    order = np.argsort(low)
    cumulative = np.concatenate([[0.0], np.cumsum(low_weight[order])])
    below, up_to = (cumulative[np.searchsorted(low[order], high, side=side)] for side in ("left", "right"))
    total = cumulative[-1] * high_weight.sum()
    return float(((below + up_to) / 2 * high_weight).sum() / total) if total else np.nan
