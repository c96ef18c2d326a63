"""Which measure notices which fault: the matrix of measures against corrupted truth.

The reference are true takes of every sound, what is judged are other takes of the same sounds, as they are and with
each fault. A measure catches a fault when it tells it from the reference by more than its bootstrap interval, in its
own direction, and farther than it tells true from true. The effect is the distance in intervals: 1 is the edge of the
interval, below 1 nothing is caught. One in twenty true takes is told apart by chance: that is what intervals mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.motion import Motion
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.windows import Recording
from talkingeyes.evaluation.benchmark.behaviour import Behaviour, behaviour
from talkingeyes.evaluation.benchmark.features import Encoder, featured, gathered
from talkingeyes.evaluation.benchmark.measure import LESS, MORE, Measure
from talkingeyes.evaluation.benchmark.registry import MEASURES
from talkingeyes.evaluation.benchmark.tally import Comparison, Row, Tally, observe
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate
from talkingeyes.evaluation.corruptions import CORRUPTIONS, NOTHING, Corruption, corrupted
from talkingeyes.evaluation.discrepancy import discrepancy
from talkingeyes.evaluation.distribution.encoder import EncoderSettings, MotionEncoder, learn_encoder
from talkingeyes.synthesis.pool import Talk

# Intervals by which a fault must be farther from the truth than other true takes are.
MARGIN = 0.5
CHANCE = 0.05


@dataclass(frozen=True)
class Takes:
    """True takes of the same sounds, as many to judge as to compare with; each judged one has one as its reference."""

    reference: Sequence[Sequence[Behaviour]]
    judged: Sequence[Sequence[Behaviour]]
    speakers: Sequence[str]


def takes_of(talks: Sequence[Talk]) -> Takes:
    """The first half of the takes of every sound is the reference, the second half is judged."""
    reference, judged = [], []
    for talk in talks:
        half = len(talk.takes) // 2
        motions = [_behaviour(motion, talk) for motion in talk.takes[: 2 * half]]
        judged.append([replace(each, reference=motions[0]) for each in motions[half:]])
        reference.append([replace(each, reference=motions[half]) for each in motions[:half]])
    return Takes(reference, judged, [talk.speaker for talk in talks])


def _behaviour(motion: Motion, talk: Talk) -> Behaviour:
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    return behaviour(motion.fps, fields, motion.valid, talk.annotation)


def pool_encoder(talks: Sequence[Talk], settings: EncoderSettings, seed: int) -> MotionEncoder:
    """An encoder that learns on the first takes of a pool; a fifth of its speakers is kept out."""
    recordings = [_recording(number, talk) for number, talk in enumerate(talks)]
    speakers = sorted({talk.speaker for talk in talks})
    kept_out = set(speakers[::5])
    train, held = ([each for each in recordings if (each.clip.speaker in kept_out) == out] for out in (False, True))
    return learn_encoder(train, held, settings, seed).encoder


def _recording(number: int, talk: Talk) -> Recording:
    motion, name = talk.takes[0], str(number)
    clip = Clip(name, name, 0, talk.speaker, "train", motion.seconds, motion.fps, "", 0, "", "", "pool", "", "")
    head, gaze = motion.head.astype(np.float32), motion.gaze.astype(np.float32)
    return Recording(clip, np.zeros((len(motion), 1), np.float32), head, gaze, motion.valid)


@dataclass(frozen=True)
class Cell:
    """A measure of one fault. `effect` in intervals; NaN where there is no figure any more, which is told too."""

    value: float
    effect: float
    true_effect: float

    @property
    def caught(self) -> bool:
        """Whether the fault is told from the truth."""
        return bool(np.isnan(self.effect) or self.effect > max(1.0, self.true_effect + MARGIN))

    @property
    def won(self) -> bool:
        """Whether the fault looks better than the truth."""
        return bool(self.effect < min(-1.0, self.true_effect - MARGIN))


# Measure to corruption to cell, in the order of the registry.
Matrix = Mapping[str, Mapping[str, Cell]]


def matrix(
    takes: Takes,
    settings: BootstrapSettings,
    encoder: Encoder | None = None,
    strength: float = 1.0,
    corruptions: Sequence[Corruption] = CORRUPTIONS,
    seed: int = 0,
) -> Matrix:
    """All measures of the registry against all corruptions; those that the takes do not allow are left out."""
    fps = takes.reference[0][0].fps
    reference = tally(takes.reference, fps, encoder)
    rows = {}
    for corruption in (NOTHING, *corruptions):
        wrong = tally(_corrupted(takes, corruption, strength, seed), fps, encoder)
        rows[corruption.name] = list(Comparison(wrong, reference, settings, paired=True).rows(MEASURES))
    found = {}
    for index, true in enumerate(rows[NOTHING.name]):
        if true.value is not None and true.reference is not None:
            found[true.measure.name] = {name: _cell(each[index], true) for name, each in rows.items()}
    return found


def _corrupted(takes: Takes, corruption: Corruption, strength: float, seed: int) -> list[list[Behaviour]]:
    """The n-th takes of all sounds are corrupted together, so that a swap takes the n-th of another."""
    columns = zip(*takes.judged, strict=True)
    wrong = [
        corrupted(column, takes.speakers, corruption, strength, seed + number) for number, column in enumerate(columns)
    ]
    return [list(motions) for motions in zip(*wrong, strict=True)]


def tally(sounds: Sequence[Sequence[Behaviour]], fps: float, encoder: Encoder | None) -> Tally:
    """The sums of all motions, sound by sound."""
    found = Tally(fps)
    for motions in sounds:
        known = featured(motions, encoder)
        found.add(observe(known), gathered(known) if encoder else None)
    return found


def l2(takes: Takes, corruption: Corruption, seed: int = 0) -> float:
    """L2 of eye-in-head to the reference's first take (radians): the distance that a constant wins."""
    wrong = _corrupted(takes, corruption, 1.0, seed)
    found = []
    for motions, reference in zip(wrong, takes.reference, strict=True):
        gazes = np.stack([_gaze(motion) for motion in motions])
        found.append(discrepancy(gazes, _gaze(reference[0])))
    return float(np.mean(found))


def _gaze(motion: Behaviour) -> Float[ndarray, "T 6"]:
    assert motion.gaze is not None
    return motion.gaze.reshape(len(motion), 6)


def catches(of_measure: Mapping[str, Cell]) -> list[str]:
    """The corruptions that a measure catches."""
    return [name for name, cell in of_measure.items() if name != NOTHING.name and cell.caught]


def _cell(row: Row, true: Row) -> Cell:
    distance = float("nan") if row.value is None or row.reference is None else effect(row)
    return Cell(float("nan") if row.value is None else row.value.value, distance, effect(true))


def effect(row: Row) -> float:
    """Distance from the reference in the measure's own direction, over the half of its interval on that side."""
    assert row.value is not None
    assert row.reference is not None
    if row.measure.unit == "p":  # a probability has no interval: 1 is where it is called improbable
        return float(np.log(row.value.value) / np.log(CHANCE))
    if row.difference is not None:
        return _signed(row.difference, row.measure)
    apart = row.value.value - row.reference.value
    if row.measure.direction == LESS:
        return _over(apart, (row.value.value - row.value.low) + (row.reference.high - row.reference.value))
    return _over(-apart, (row.value.high - row.value.value) + (row.reference.value - row.reference.low))


def _signed(difference: Estimate, measure: Measure) -> float:
    worse = difference.value
    if measure.direction == MORE or (measure.direction != LESS and worse < 0):
        return _over(-worse, difference.high - worse)
    return _over(worse, worse - difference.low)


def _over(distance: float, half: float) -> float:
    if distance == 0:
        return 0.0
    return distance / half if half > 0 else float("inf") if distance > 0 else float("-inf")
