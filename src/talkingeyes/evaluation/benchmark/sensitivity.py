"""Sensitivity matrix: which metric detects which corruption of true motion.

The reference is a set of true takes of every sound; other takes of the same sounds are evaluated, unchanged and with
each corruption. A metric detects a corruption if the difference from the reference, in the metric's direction, exceeds
its bootstrap interval and the difference of unchanged takes. The effect size is the difference in intervals: 1 is the
edge of the interval, and below 1 nothing is detected. By chance, one unchanged take in twenty is detected too, as
follows from the intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.recordings import Recording
from talkingeyes.evaluation.benchmark.comparison import Accumulator, Comparison, MetricResult, extract
from talkingeyes.evaluation.benchmark.corruptions import CORRUPTIONS, UNCORRUPTED, Corruption, apply_corruption
from talkingeyes.evaluation.benchmark.paired import motion_behaviours
from talkingeyes.evaluation.benchmark.registry import METRICS
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate
from talkingeyes.evaluation.detectors.behaviour import Behaviour
from talkingeyes.evaluation.measures.features import Encoder, add_features, gather_features
from talkingeyes.evaluation.measures.metric import HIGHER, LOWER, Metric
from talkingeyes.evaluation.measures.motion_encoder import EncoderSettings, MotionEncoder, fit_motion_encoder
from talkingeyes.evaluation.papers.talkingeyes_metrics import l2_error
from talkingeyes.synthesis.sketched_clips import SketchedClip

# Intervals by which the effect of a corruption must exceed that of unchanged takes.
MARGIN = 0.5
SIGNIFICANCE_LEVEL = 0.05


@dataclass(frozen=True)
class TakeSets:
    """True takes of the same sounds: as many evaluated as reference takes; each evaluated take has one as reference."""

    reference: Sequence[Sequence[Behaviour]]
    evaluated: Sequence[Sequence[Behaviour]]
    speakers: Sequence[str]


def split_takes(talks: Sequence[SketchedClip]) -> TakeSets:
    """Split the takes of every sound: the first half is the reference, the second half is evaluated."""
    reference, evaluated = [], []
    for talk in talks:
        half = len(talk.takes) // 2
        motions = motion_behaviours(talk.takes[: 2 * half], talk.annotation)
        evaluated.append([replace(each, reference=motions[0]) for each in motions[half:]])
        reference.append([replace(each, reference=motions[half]) for each in motions[:half]])
    return TakeSets(reference, evaluated, [talk.speaker for talk in talks])


def train_pool_encoder(talks: Sequence[SketchedClip], settings: EncoderSettings, seed: int) -> MotionEncoder:
    """Train a motion encoder on the first takes of a pool, with a fifth of its speakers held out."""
    recordings = [_recording(number, talk) for number, talk in enumerate(talks)]
    speakers = sorted({talk.speaker for talk in talks})
    held_out = set(speakers[::5])
    train, held = ([each for each in recordings if (each.clip.speaker in held_out) == out] for out in (False, True))
    return fit_motion_encoder(train, held, settings, seed).encoder


def _recording(number: int, talk: SketchedClip) -> Recording:
    motion, name = talk.takes[0], str(number)
    clip = Clip(name, name, 0, talk.speaker, "train", motion.seconds, motion.fps, "", 0, "", "", "pool", "", "")
    head, gaze = motion.head.astype(np.float32), motion.gaze.astype(np.float32)
    return Recording(clip, np.zeros((len(motion), 1), np.float32), head, gaze, motion.valid)


@dataclass(frozen=True)
class CorruptionEffect:
    """A metric under one corruption.

    `effect_size` is in intervals, NaN if the metric is no longer defined: then it tells nothing, and detects nothing.
    """

    value: float
    effect_size: float
    baseline_effect: float

    @property
    def measured(self) -> bool:
        """Whether the metric is still defined."""
        return not np.isnan(self.effect_size)

    @property
    def detected(self) -> bool:
        """Whether the metric detects the corruption, by its value."""
        return bool(self.effect_size > max(1.0, self.baseline_effect + MARGIN))

    @property
    def rated_better(self) -> bool:
        """Whether the metric rates the corruption better than the truth."""
        return bool(self.effect_size < min(-1.0, self.baseline_effect - MARGIN))


# {metric: {corruption: effect}}, in the order of the registry.
SensitivityMatrix = Mapping[str, Mapping[str, CorruptionEffect]]
# {metric: {corruption: smallest dose from which on all are detected, by a value}}; None: not even the largest.
SmallestDoses = Mapping[str, Mapping[str, float | None]]


def sensitivity_matrix(
    takes: TakeSets,
    settings: BootstrapSettings,
    encoder: Encoder | None = None,
    strength: float = 1.0,
    corruptions: Sequence[Corruption] = CORRUPTIONS,
) -> SensitivityMatrix:
    """Evaluate all metrics of the registry on all corruptions; metrics undefined on these takes are left out."""
    names = [each.name for each in (UNCORRUPTED, *corruptions)]
    columns = list(_effects(takes, settings, encoder, [(each, strength) for each in (UNCORRUPTED, *corruptions)]))
    return {
        metric: {name: column[metric] for name, column in zip(names, columns, strict=True)} for metric in columns[0]
    }


def smallest_doses(
    takes: TakeSets,
    settings: BootstrapSettings,
    encoder: Encoder | None = None,
    corruptions: Sequence[Corruption] = CORRUPTIONS,
) -> SmallestDoses:
    """The smallest doses that each metric detects, for the corruptions that have doses."""
    dosed = [each for each in corruptions if each.doses]
    variants = [(each, each.strength(dose)) for each in dosed for dose in each.doses]
    columns = _effects(takes, settings, encoder, variants)
    by_dose = {each.name: {dose: next(columns) for dose in each.doses} for each in dosed}
    first = next(iter(by_dose[dosed[0].name].values()))
    return {
        metric: {
            name: _smallest({dose: column[metric] for dose, column in doses.items()}) for name, doses in by_dose.items()
        }
        for metric in first
    }


def _smallest(effects: Mapping[float, CorruptionEffect]) -> float | None:
    """The smallest detected dose above all whose value is not; None if there is none."""
    limit = max((dose for dose, effect in effects.items() if effect.measured and not effect.detected), default=0.0)
    return min((dose for dose, effect in effects.items() if dose > limit and effect.detected), default=None)


def _effects(
    takes: TakeSets,
    settings: BootstrapSettings,
    encoder: Encoder | None,
    variants: Iterable[tuple[Corruption, float]],
) -> Iterator[dict[str, CorruptionEffect]]:
    """The effect on each metric, for each corruption and strength; metrics undefined on these takes are left out."""
    fps = takes.reference[0][0].fps
    reference = accumulate(takes.reference, fps, encoder)

    def rows(corruption: Corruption, strength: float) -> list[MetricResult]:
        wrong = accumulate(_corrupted(takes, corruption, strength), fps, encoder)
        return list(Comparison(wrong, reference, settings, paired=True).rows(METRICS))

    true = rows(UNCORRUPTED, 0.0)
    for corruption, strength in variants:
        yield {
            row.metric.name: _cell(row, unchanged)
            for row, unchanged in zip(rows(corruption, strength), true, strict=True)
            if unchanged.value is not None and unchanged.reference is not None
        }


def _corrupted(takes: TakeSets, corruption: Corruption, strength: float) -> list[list[Behaviour]]:
    """Corrupt the n-th takes of all sounds together with seed n, so that a swap uses the n-th take of another sound."""
    columns = zip(*takes.evaluated, strict=True)
    wrong = [
        apply_corruption(column, takes.speakers, corruption, strength, number) for number, column in enumerate(columns)
    ]
    return [list(motions) for motions in zip(*wrong, strict=True)]


def accumulate(sounds: Sequence[Sequence[Behaviour]], fps: float, encoder: Encoder | None) -> Accumulator:
    """Accumulate the statistics of all motions, sound by sound."""
    found = Accumulator(fps)
    for motions in sounds:
        known = add_features(motions, encoder)
        found.add(extract(known), gather_features(known) if encoder else None)
    return found


def mean_l2(takes: TakeSets, corruption: Corruption) -> float:
    """L2 of eye-in-head to the first reference take, in radians; a constant near the mean scores best."""
    wrong = _corrupted(takes, corruption, 1.0)
    found = []
    for motions, reference in zip(wrong, takes.reference, strict=True):
        gazes = np.stack([_gaze(motion) for motion in motions])
        found.append(l2_error(gazes, _gaze(reference[0])))
    return float(np.mean(found))


def _gaze(motion: Behaviour) -> Float[ndarray, "T 6"]:
    assert motion.gaze is not None
    return motion.gaze.reshape(len(motion), 6)


def _cell(row: MetricResult, true: MetricResult) -> CorruptionEffect:
    distance = float("nan") if row.value is None or row.reference is None else effect_size(row)
    return CorruptionEffect(float("nan") if row.value is None else row.value.value, distance, effect_size(true))


def effect_size(row: MetricResult) -> float:
    """Difference from the reference in the metric's direction, over the half width of its interval on that side."""
    assert row.value is not None
    assert row.reference is not None
    if row.metric.unit == "p":  # a probability has no interval: 1 is at the significance level
        return float(np.log(row.value.value) / np.log(SIGNIFICANCE_LEVEL))
    if row.difference is not None:
        return _signed(row.difference, row.metric)
    apart = row.value.value - row.reference.value
    if row.metric.direction == LOWER:
        return _over(apart, (row.value.value - row.value.low) + (row.reference.high - row.reference.value))
    return _over(-apart, (row.value.high - row.value.value) + (row.reference.value - row.reference.low))


def _signed(difference: Estimate, metric: Metric) -> float:
    worse = difference.value
    if metric.direction == HIGHER or (metric.direction != LOWER and worse < 0):
        return _over(-worse, difference.high - worse)
    return _over(worse, worse - difference.low)


def _over(distance: float, half: float) -> float:
    if distance == 0:
        return 0.0
    return distance / half if half > 0 else float("inf") if distance > 0 else float("-inf")
