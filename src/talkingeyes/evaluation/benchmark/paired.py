"""Benchmark of motions paired with the truth of the same sounds: statistics of each sound, then the table of all.

The statistics of a sound (`SoundStatistics`) are small, so sounds can be processed in parallel processes. Sound n is
the same for motions and truth, and a resample contains it for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.benchmark.comparison import Accumulator, Comparison, MetricResult, extract
from talkingeyes.evaluation.benchmark.metric_class import LearntCount, count_learnt
from talkingeyes.evaluation.benchmark.table import as_json
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.detectors.behaviour import FIELDS, Behaviour, behaviour, with_references
from talkingeyes.evaluation.measures.corr import CorrScorer, CorrScores, with_corr, with_corr_scores
from talkingeyes.evaluation.measures.features import Encoder, add_features, gather_features
from talkingeyes.evaluation.measures.metric import Metric


@dataclass(frozen=True)
class MotionSets:
    """Motions of one sound: those to evaluate (motion n is sample n) and true ones."""

    evaluated: list[Behaviour]
    reference: list[Behaviour]


@dataclass(frozen=True)
class SoundStatistics:
    """Statistics of a sound: sums and features of windows, of the motions and of the truth."""

    fps: float
    sums: Float[ndarray, " K"]
    features: Float[ndarray, "W D"]
    true_sums: Float[ndarray, " K"]
    true_features: Float[ndarray, "V D"]


def motion_behaviours(motions: Sequence[Motion], annotation: Annotation) -> list[Behaviour]:
    """Behaviours of complete motions, with lids and valid frames."""
    return [
        behaviour(motion.fps, {name: getattr(motion, name) for name in FIELDS}, motion.valid, annotation)
        for motion in motions
    ]


def sample_behaviours(samples: Samples, annotation: Annotation) -> list[Behaviour]:
    """Behaviours of the samples of a model: head and gaze, all frames valid."""
    return [
        behaviour(samples.fps, {"head": head, "gaze": gaze}, None, annotation)
        for head, gaze in zip(samples.head, samples.gaze, strict=True)
    ]


def pair_with_truth(evaluated: Sequence[Behaviour], true: Sequence[Behaviour]) -> MotionSets:
    """Set the first true motion as the reference of all evaluated motions, and the next true motion as that of each."""
    reference = with_references(true)
    return MotionSets([replace(each, reference=reference[0]) for each in evaluated], reference)


def sound_statistics(
    motion_sets: MotionSets,
    scores: Mapping[str, CorrScores],
    critics: Mapping[str, CorrScorer],
    encoder: Encoder | None,
    speech: Float[ndarray, "T C"],
    others: Sequence[Float[ndarray, "_ C"]],
) -> SoundStatistics:
    """Statistics of one sound.

    `scores` are the Corr. of the evaluated motions; those of the true motions are computed here. Without an encoder
    there are no features of windows, and the metrics that need them have no value.
    """
    evaluated = add_features(with_corr_scores(motion_sets.evaluated, scores), encoder)
    reference = add_features(with_corr(motion_sets.reference, critics, speech, others), encoder)
    return SoundStatistics(
        motion_sets.reference[0].fps,
        extract(evaluated),
        gather_features(evaluated),
        extract(reference),
        gather_features(reference),
    )


@dataclass(frozen=True)
class BenchmarkTable:
    """The benchmark over all sounds: a row for each metric, and the number of sounds and frame rate as metadata."""

    rows: list[MetricResult]
    missing: list[Metric]  # with enough events in the truth and too few in the motions; they count as worse
    metadata: dict[str, int | float]

    @property
    def learnt(self) -> LearntCount:
        """Learnt metrics by which the motions are worse than the truth by more than the interval."""
        return count_learnt(self.rows, self.missing)

    def json(self) -> str:
        """Contents of benchmark.json."""
        return as_json(self.rows, self.metadata)


class PairedAccumulator:
    """Accumulated sums of motions and of the truth over the same sounds."""

    def __init__(self) -> None:
        self._tallies: tuple[Accumulator, Accumulator] | None = None

    def add(self, one: SoundStatistics) -> None:
        """Add a sound."""
        ours, theirs = self._tallies = self._tallies or (Accumulator(one.fps), Accumulator(one.fps))
        ours.add(one.sums, one.features)
        theirs.add(one.true_sums, one.true_features)

    def table(self, settings: BootstrapSettings) -> BenchmarkTable:
        """Table over all sounds; without sounds it has no rows."""
        if self._tallies is None:
            return BenchmarkTable([], [], {"sounds": 0})
        ours, theirs = self._tallies
        comparison = Comparison(ours, theirs, settings, paired=True)
        return BenchmarkTable(list(comparison.rows()), comparison.missing(), {"sounds": ours.clips, "fps": ours.fps})
