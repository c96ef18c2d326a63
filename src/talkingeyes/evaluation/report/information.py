"""Information that speech gives about motion, and about gaze aversion in any motion, in nats per second.

About motion it is the log-likelihood of the events of true motion under a model, less that under its twin that was
trained without speech input. The head is scored given speech, gaze given speech and head, so the parts add up to the
information about the whole motion (chain rule). What moves like people whatever the sound has none; under another sound
it is negative for a model that relies on speech. Intervals are over speakers.

About gaze aversion: in steps of 80 ms, the hazard of leaving the partner, and that of returning, is a logistic
regression on the time since the last change, without and with the events of speech (in bins of 0.25 s up to 2 s before
and after each). The figure is the gain in log-likelihood by the events on speakers that the regression was not fitted
to (five folds). It needs no likelihood of a model; gaze that moves like people whatever the sound has none (below 0:
what the regression overfits). It says that events are locked to speech, not that they are where people's are: a rule
has more of it than people. `aversion_prediction` asks for the latter: the same hazards of the true gaze, without and
with how many of the motions generated for that sound are averted.

Small effects count by their square: with half of the truth's change of averted gaze around events, gaze has about a
quarter of its information. A conditional mean has much information about little motion: read it with `changes_per_s`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, ratio_statistic
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.partner_gaze import EVENTS, event_times
from talkingeyes.evaluation.text_tables import markdown_table

PARTS = ("head", "gaze")
COLUMNS = ("total", *PARTS)


@dataclass(frozen=True)
class ClipLikelihood:
    """Log-likelihood of the motion of one clip in nats; terms are named by part (`head_time`)."""

    clip: str
    speaker: str
    seconds: float
    terms: Mapping[str, float]


def information(
    with_speech: Sequence[ClipLikelihood], without_speech: Sequence[ClipLikelihood], settings: BootstrapSettings
) -> dict[str, Estimate]:
    """Information of speech about the same clips: `total`, that of each part, and of each term.

    `without_speech` may hold more clips.
    """
    twin = {each.clip: each for each in without_speech}
    speakers = sorted({each.speaker for each in with_speech})
    seconds = np.zeros(len(speakers))
    gained: dict[str, np.ndarray] = {}
    for each in with_speech:
        row = speakers.index(each.speaker)
        seconds[row] += each.seconds
        for term, value in each.terms.items():
            gained.setdefault(term, np.zeros(len(speakers)))[row] += value - twin[each.clip].terms[term]
    parts = {part: [of for term, of in gained.items() if term.startswith(f"{part}_")] for part in PARTS}
    sums = {part: np.sum(of, axis=0) for part, of in parts.items() if of}
    figures = {"total": np.sum(list(sums.values()), axis=0), **sums, **gained}
    return {
        name: bootstrap(ratio_statistic(values, seconds), len(speakers), settings) for name, values in figures.items()
    }


def mean_log_likelihood(terms: Sequence[Mapping[str, float]], seconds: Sequence[float]) -> dict[str, float]:
    """Log-likelihood of all clips in nats per second, `log_likelihood`, and that of each part; empty without terms.

    Unlike information it needs no twin; it ranks models that are trained on the same events.
    """
    figures = {}
    for part in PARTS:
        values = [value for clip in terms for term, value in clip.items() if term.startswith(f"{part}_")]
        if values:
            figures[f"log_likelihood_{part}"] = sum(values) / sum(seconds)
    return {"log_likelihood": sum(figures.values()), **figures} if figures else {}


def information_table(rows: Mapping[str, Mapping[str, Any]], titles: Mapping[str, str]) -> str:
    """Markdown table of the rows of the stage `information`: {row: {split: {sound: {figure: estimate}}}}.

    A part without a likelihood has an empty cell.
    """
    splits = list(next(iter(rows.values())))
    headings = ["", *(f"{split}: {column}" for split in splits for column in COLUMNS), f"{splits[-1]}: another sound"]
    lines = []
    for name, row in rows.items():
        cells = [_cell(row[split]["own"].get(column)) for split in splits for column in COLUMNS]
        other = row[splits[-1]].get("other", {}).get("total")
        lines.append([titles.get(name, name), *cells, _cell(other)])
    return markdown_table(headings, lines)


def _cell(estimate: Mapping[str, float] | None) -> str:
    return "" if estimate is None else "{value:.2f} ({low:.2f} to {high:.2f})".format(**estimate)


BIN_FRAMES = 2
LAGS_S = np.arange(-8, 9) / 4
STATES = 4  # speaking, listening, pausing, filling
AGES = (1, 2, 4, 6, 9, 13, 19, 28, 40)  # bins since the last change
FOLDS = 5
PENALTY = 0.1  # sklearn's C
LIVE_LOOKAHEAD_S = 0.25  # that of talkingeyes_live, rounded up to a bin of LAGS_S
# How many generated motions are averted: smoothed, and taken before, at and after the next bin.
PREDICTION_SIGMA_BINS, PREDICTION_BINS = 2.0, np.array([-5, 0, 5])


@dataclass(frozen=True)
class SoundAversion:
    """Gaze of S motions for one sound in N bins of 80 ms: averted or not; and the events of the speech."""

    speaker: str
    averted: Bool[ndarray, "S N"]
    speech: Bool[ndarray, "N F"]
    seconds: float  # of all motions together

    @property
    def changes(self) -> Bool[ndarray, "S M"]:
        """Whether the state changes in the next bin."""
        return np.asarray(self.averted[:, 1:] != self.averted[:, :-1])

    @property
    def age(self) -> Float[ndarray, "S M A"]:
        """The class of the time since the last change, one-hot."""
        bins = np.arange(self.averted.shape[1] - 1)
        changed = np.diff(self.averted[:, :-1], axis=1, prepend=self.averted[:, :1])
        last = np.maximum.accumulate(np.where(changed, bins, 0), axis=1)
        return np.asarray(np.eye(len(AGES) + 1, dtype=np.float32)[np.digitize(bins - last, AGES)])


def sound_aversion(speaker: str, motions: Sequence[Behaviour]) -> SoundAversion:
    """Bins of the motions of one sound, cut to the shortest; their annotation is that of the sound."""
    annotation, fps, frames = motions[0].annotation, motions[0].fps, min(map(len, motions))
    assert annotation is not None
    averted = np.stack([each.states.averted[: frames // BIN_FRAMES * BIN_FRAMES : BIN_FRAMES] for each in motions])
    times_s = (np.arange(averted.shape[1]) + 0.5) * BIN_FRAMES / fps
    return SoundAversion(
        speaker, averted, speech_events(annotation, times_s, frames / fps), len(motions) * frames / fps
    )


def speech_events(annotation: Annotation, times_s: Float[ndarray, " N"], seconds: float) -> Bool[ndarray, "N F"]:
    """For each kind of event the lag of an event, in bins; and whether the speaker talks, listens, pauses or fills."""
    columns = []
    for events_s in event_times(annotation, seconds).values():
        lag = times_s[:, None] - np.array(events_s)
        inside = (lag[..., None] >= LAGS_S[:-1]) & (lag[..., None] < LAGS_S[1:])
        columns.append(inside.any(axis=1))
    spans = (annotation.speaking, annotation.listening, annotation.pauses, annotation.fillers)
    return np.hstack([*columns, *(_covered(times_s, each)[:, None] for each in spans)])


def _covered(times_s: Float[ndarray, " N"], spans: Sequence[Span]) -> Bool[ndarray, " N"]:
    inside = [(times_s >= each.start_s) & (times_s < each.end_s) for each in spans]
    return np.any(inside, axis=0) if inside else np.zeros(len(times_s), bool)


def shift_in_time(sounds: Sequence[SoundAversion], seed: int) -> list[SoundAversion]:
    """The same motions under the same speech, each sound's shifted round by a random lag: no event is in its place."""
    random = np.random.default_rng(seed)
    lags = [int(random.integers(each.averted.shape[1])) for each in sounds]
    return [replace(each, averted=np.roll(each.averted, lag, axis=1)) for each, lag in zip(sounds, lags, strict=True)]


def changes_per_s(sounds: Sequence[SoundAversion]) -> float:
    """How often gaze leaves the partner or returns."""
    return float(sum(each.changes.sum() for each in sounds) / sum(each.seconds for each in sounds))


def aversion_information(
    sounds: Sequence[SoundAversion],
    settings: BootstrapSettings,
    further: Sequence[SoundAversion] = (),
    lookahead_s: float = np.inf,
) -> Estimate:
    """Information about the motions of `sounds`, with its interval over speakers.

    The regression is fitted to `further` motions too, which do not count: a few hours are needed. Events that are more
    than `lookahead_s` ahead are left out: the most that a live model can follow.
    """
    known = np.concatenate([np.tile(LAGS_S[:-1] >= -lookahead_s, len(EVENTS)), np.ones(STATES, bool)])
    both = [*sounds, *further]
    changes = _Changes.of(both)
    speech = np.concatenate([np.tile(each.speech[1:, known], (len(each.averted), 1)) for each in both])
    gain = changes.gain(speech.astype(np.float32))
    return _nats_per_second(gain, sounds, settings)


def aversion_prediction(
    generated: Sequence[SoundAversion], true: Sequence[SoundAversion], settings: BootstrapSettings
) -> Estimate:
    """What motions generated for a sound tell about when true gaze of the same sound changes, in nats a second, with
    its interval over speakers: how much more likely they are given how many of the motions are averted.

    Entry n of both belongs to one sound. The regression calibrates the odds, so that what counts is what they tell, not
    how sure they are; motion that knows nothing of the sound has none.
    """
    changes = _Changes.of(true)
    predictors = []
    for own, truth in zip(generated, true, strict=True):
        count = truth.averted.shape[1]
        frames = np.minimum(np.arange(1, count)[:, None] + PREDICTION_BINS, own.averted.shape[1] - 1)
        averted = gaussian_filter1d(own.averted.sum(axis=0).astype(float), PREDICTION_SIGMA_BINS, mode="nearest")
        odds = np.log((averted + 0.5) / (len(own.averted) - averted + 0.5))
        predictors.append(np.tile(odds[np.maximum(frames, 0)], (len(truth.averted), 1)))
    gain = changes.gain(np.concatenate(predictors).astype(np.float32))
    return _nats_per_second(gain, true, settings)


@dataclass(frozen=True)
class _Changes:
    """All bins of some motions, one after the other: their states, what happens next, and the fold of their speaker."""

    averted: Bool[ndarray, " K"]
    changes: Bool[ndarray, " K"]
    age: Float[ndarray, "K A"]
    fold: Int[ndarray, " K"]

    @classmethod
    def of(cls, sounds: Sequence[SoundAversion]) -> _Changes:
        speakers = sorted({each.speaker for each in sounds})
        folds = dict(zip(speakers, np.random.default_rng(0).permutation(len(speakers)) % FOLDS, strict=True))
        return cls(
            np.concatenate([each.averted[:, :-1].ravel() for each in sounds]),
            np.concatenate([each.changes.ravel() for each in sounds]),
            np.concatenate([each.age.reshape(-1, len(AGES) + 1) for each in sounds]),
            np.repeat([folds[each.speaker] for each in sounds], [each.changes.size for each in sounds]),
        )

    def gain(self, predictors: Float[ndarray, "K F"]) -> Float[ndarray, " K"]:
        """How much more likely each change, or none, is given predictors besides the age; fitted to other speakers."""
        gain = np.zeros(len(self.changes))
        for state in (False, True):
            for held_out in range(FOLDS):
                train, test = (
                    (self.averted == state) & each for each in (self.fold != held_out, self.fold == held_out)
                )
                without, with_predictors = (
                    _log_likelihood(features[train], self.changes[train], features[test], self.changes[test])
                    for features in (self.age, np.hstack([self.age, predictors]))
                )
                gain[test] = with_predictors - without
        return gain


def _nats_per_second(
    gain: Float[ndarray, " K"], sounds: Sequence[SoundAversion], settings: BootstrapSettings
) -> Estimate:
    """Gain a second of the first sounds, whose bins come first."""
    counted = sorted({each.speaker for each in sounds})
    rows = [counted.index(each.speaker) for each in sounds]
    owner = np.repeat(rows, [each.changes.size for each in sounds])
    seconds = np.bincount(rows, [each.seconds for each in sounds], len(counted))
    total = np.bincount(owner, gain[: len(owner)], len(counted))
    return bootstrap(ratio_statistic(total, seconds), len(counted), settings)


def _log_likelihood(
    features: Float[ndarray, "N F"],
    changes: Bool[ndarray, " N"],
    new: Float[ndarray, "M F"],
    outcome: Bool[ndarray, " M"],
) -> Float[ndarray, " M"]:
    from sklearn.linear_model import LogisticRegression

    if len(np.unique(changes)) < 2 or not len(new):  # gaze that stands still
        return np.zeros(len(new))
    model = LogisticRegression(C=PENALTY, max_iter=300).fit(features, changes)
    log_probability = model.predict_log_proba(new)
    return np.asarray(log_probability[np.arange(len(new)), outcome.astype(int)])
