"""Information of speech about gaze aversion, for the true motion of a finished chain and for its models.

Run     python -m benchmarks.aversion_information [DATA]     (the data folder of a finished chain: `data` by default;
        three minutes)
Reads   DATA/synthesize, fit, embed (the list of sounds) and sample
Writes  a table

In steps of 80 ms, the hazard of leaving the partner, and that of returning, is a logistic regression on the time since
the last change, without and with the events of speech (in bins of 0.25 s up to 2 s before and after each). The figure
is the gain in log-likelihood by the events, in nats per second, on speakers that the regression was not fitted to (five
folds). It needs no likelihood of a model, so it is defined for any motion; gaze that moves like people whatever the
sound has none (below 0: what the regression overfits). Small effects count by their square: with half of the truth's
change of averted gaze around events, gaze has about a quarter of its information.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.fitted_clips import motion_path
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.sound_groups import group_sounds
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.behaviour import behaviour
from talkingeyes.evaluation.benchmark.partner_gaze import event_times
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap, ratio_statistic
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
from talkingeyes.orchestration.run import configure_environment
from talkingeyes.training.model_folder import is_face_model

BIN_FRAMES = 2
LAGS_S = np.arange(-8, 9) / 4
AGES = (1, 2, 4, 6, 9, 13, 19, 28, 40)  # bins since the last change
FOLDS = 5
PENALTY = 0.1  # sklearn's C
MAX_TAKES = 10
SPLITS = ("test", "unseen")
BOOTSTRAP = BootstrapSettings(n_resamples=1000, confidence_level=0.95, seed=0)


@dataclass(frozen=True)
class Aversion:
    """Gaze of one motion in bins of 80 ms: averted or not, whether that changes in the next bin, and predictors."""

    speaker: str
    averted: Bool[ndarray, " N"]
    changes: Bool[ndarray, " N"]
    age: Float[ndarray, "N A"]
    speech: Float[ndarray, "N F"]
    seconds: float


def aversion(speaker: str, fps: float, averted: Bool[ndarray, " T"], annotation: Annotation) -> Aversion:
    """Bins of a motion whose gaze is `averted` in these frames, and the events of its speech."""
    state = averted[: len(averted) // BIN_FRAMES * BIN_FRAMES : BIN_FRAMES]
    bins = np.arange(len(state))
    last_change = np.maximum.accumulate(np.where(np.diff(state, prepend=state[0]), bins, 0))
    seconds = len(state) * BIN_FRAMES / fps
    age = np.eye(len(AGES) + 1)[np.digitize(bins - last_change, AGES)]
    speech = speech_events(annotation, (bins + 0.5) * BIN_FRAMES / fps, len(averted) / fps)
    return Aversion(speaker, state[:-1], state[1:] != state[:-1], age[:-1], speech[1:], seconds)


def speech_events(annotation: Annotation, times_s: Float[ndarray, " N"], seconds: float) -> Float[ndarray, "N F"]:
    """For each kind of event the lag of an event, in bins; and whether the speaker talks, listens, pauses or fills."""
    columns = []
    for events_s in event_times(annotation, seconds).values():
        lag = times_s[:, None] - np.array(events_s)
        inside = (lag[..., None] >= LAGS_S[:-1]) & (lag[..., None] < LAGS_S[1:])
        columns.append(inside.any(axis=1))
    spans = (annotation.speaking, annotation.listening, annotation.pauses, annotation.fillers)
    return np.hstack([*columns, *(_covered(times_s, each)[:, None] for each in spans)]).astype(np.float32)


def _covered(times_s: Float[ndarray, " N"], spans: Sequence[Span]) -> Bool[ndarray, " N"]:
    inside = [(times_s >= each.start_s) & (times_s < each.end_s) for each in spans]
    return np.any(inside, axis=0) if inside else np.zeros(len(times_s), bool)


def aversion_information(motions: Sequence[Aversion]) -> Estimate:
    """Nats per second that the events of speech give about leaving and returning; the interval is over speakers."""
    speakers = sorted({each.speaker for each in motions})
    fold_of = dict(zip(speakers, np.random.default_rng(0).permutation(len(speakers)) % FOLDS, strict=True))
    fold = np.concatenate([np.full(len(each.changes), fold_of[each.speaker]) for each in motions])
    owner = np.concatenate([np.full(len(each.changes), speakers.index(each.speaker)) for each in motions])
    averted, changes, age, speech = (
        np.concatenate([getattr(each, name) for each in motions]) for name in ("averted", "changes", "age", "speech")
    )
    gain = np.zeros(len(changes))
    for state in (False, True):
        for held_out in range(FOLDS):
            train, test = (averted == state) & (fold != held_out), (averted == state) & (fold == held_out)
            without, with_speech = (
                _log_likelihood(features[train], changes[train], features[test], changes[test])
                for features in (age, np.hstack([age, speech]))
            )
            gain[test] = with_speech - without
    seconds = np.zeros(len(speakers))
    np.add.at(seconds, [speakers.index(each.speaker) for each in motions], [each.seconds for each in motions])
    total = np.bincount(owner, gain, len(speakers))
    return bootstrap(ratio_statistic(total, seconds), len(speakers), BOOTSTRAP)


def _log_likelihood(
    features: Float[ndarray, "N F"],
    changes: Bool[ndarray, " N"],
    new: Float[ndarray, "M F"],
    outcome: Bool[ndarray, " M"],
) -> Float[ndarray, " M"]:
    from sklearn.linear_model import LogisticRegression

    if not changes.any():  # gaze that stands still
        return np.zeros(len(new))
    model = LogisticRegression(C=PENALTY, max_iter=300).fit(features, changes)
    log_probability = model.predict_log_proba(new)
    return np.asarray(log_probability[np.arange(len(new)), outcome.astype(int)])


def motions_of(corpus: Corpus, data: Path, row: str, clips: Sequence[Clip]) -> Iterator[Aversion]:
    """Motions of a row for these clips: true or fitted ones, or the samples of a model."""
    for clip in clips:
        if row in ("truth", "fitted"):
            motion = corpus.truth(clip) if row == "truth" else Motion.load(motion_path(data / "fit", clip))
            samples = Samples(motion.fps, motion.head[None], motion.gaze[None])
        else:
            samples = Samples.load(shard_path(data / "sample" / row, clip.id, ".npz"))
        annotation = corpus.annotation(clip)
        for head, gaze in zip(samples.head, samples.gaze, strict=True):
            states = behaviour(samples.fps, {"head": head, "gaze": gaze}).states
            yield aversion(clip.speaker, samples.fps, states.averted, annotation)


def main(data: Path) -> None:
    """Print a row for the true and fitted motion of the train split, then for each row of test and unseen."""
    corpus = Corpus(data / "synthesize")
    train = corpus.select("train", take=0)
    groups = group_sounds(corpus, data / "fit", data / "embed", SPLITS, MAX_TAKES, 0)
    takes, sounds = [take for group in groups for take in group.takes], [group.clip for group in groups]
    models = sorted(path.name for path in (data / "sample").iterdir() if not is_face_model(data / "train" / path.name))
    rows = [(f"{row}, training sounds", row, train) for row in ("truth", "fitted")]
    rows += [(row, row, takes) for row in ("truth", "fitted")] + [(row, row, sounds) for row in models]
    for cells in (["", "nats per second", "changes per second", "hours"], ["---"] * 4):
        print(markdown_row(cells))
    for name, row, clips in rows:
        found = list(motions_of(corpus, data, row, clips))
        estimate, seconds = aversion_information(found), sum(each.seconds for each in found)
        figure = f"{estimate.value:.4f} ({estimate.low:.4f} to {estimate.high:.4f})"
        rate = sum(each.changes.sum() for each in found) / seconds
        print(markdown_row([name, figure, f"{rate:.2f}", f"{seconds / 3600:.1f}"]), flush=True)


if __name__ == "__main__":
    configure_environment()
    main(Path(sys.argv[1] if sys.argv[1:] else "data"))
