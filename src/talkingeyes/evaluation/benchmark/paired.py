"""The benchmark of motions beside the truth of the very same sounds: a sound at a time, then the table of all.

What is kept of a sound (`Counted`) is small, so sounds may be measured in processes of their own; the n-th sound of
both sides is the same, and a resample draws it for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.evaluation.benchmark.behaviour import FIELDS, Behaviour, behaviour, with_references
from talkingeyes.evaluation.benchmark.features import Encoder, featured, gathered
from talkingeyes.evaluation.benchmark.sound import Critic, Heard, with_corr, with_heard
from talkingeyes.evaluation.benchmark.table import as_json
from talkingeyes.evaluation.benchmark.tally import Comparison, Row, Tally, observe
from talkingeyes.evaluation.bootstrap import BootstrapSettings


@dataclass(frozen=True)
class Compared:
    """What is looked at under one sound: motions to judge, the n-th of them the n-th sample, and true ones."""

    judged: list[Behaviour]
    reference: list[Behaviour]


@dataclass(frozen=True)
class Counted:
    """What is kept of a sound: sums and features of windows, of the motions and of the truth."""

    fps: float
    sums: Float[ndarray, " K"]
    features: Float[ndarray, "W D"]
    true_sums: Float[ndarray, " K"]
    true_features: Float[ndarray, "V D"]


def of_motions(motions: Sequence[Motion], annotation: Annotation) -> list[Behaviour]:
    """Motions with lids and with what was seen of them."""
    return [
        behaviour(motion.fps, {name: getattr(motion, name) for name in FIELDS}, motion.valid, annotation)
        for motion in motions
    ]


def of_samples(samples: Samples, annotation: Annotation) -> list[Behaviour]:
    """Samples of a model: head and gaze, all frames valid."""
    return [
        behaviour(samples.fps, {"head": head, "gaze": gaze}, None, annotation)
        for head, gaze in zip(samples.head, samples.gaze, strict=True)
    ]


def compared(judged: Sequence[Behaviour], true: Sequence[Behaviour]) -> Compared:
    """Each of the judged beside the first true motion, and true ones each beside the next."""
    reference = with_references(true)
    return Compared([replace(each, reference=reference[0]) for each in judged], reference)


def counted(
    beside: Compared,
    heard: Mapping[str, Heard],
    critics: Mapping[str, Critic],
    encoder: Encoder | None,
    speech: Float[ndarray, "T C"],
    others: Sequence[Float[ndarray, "_ C"]],
) -> Counted:
    """One sound; `heard` is what the critics say of the judged motions, of the true ones they are asked here.

    Without an encoder there are no features of windows, and the measures that need them have no figure.
    """
    judged = featured(with_heard(beside.judged, heard), encoder)
    reference = featured(with_corr(beside.reference, critics, speech, others), encoder)
    return Counted(beside.reference[0].fps, observe(judged), gathered(judged), observe(reference), gathered(reference))


@dataclass(frozen=True)
class Table:
    """The benchmark over all sounds: a row a measure, and how many sounds and which frame rate they are of."""

    rows: list[Row]
    missing: int  # measures of what the truth does often enough and the motions do not: apart, too
    facts: dict[str, int | float]

    @property
    def apart(self) -> int:
        """Measures by which the motions are worse than the truth by more than the interval."""
        return sum(bool(row.apart) for row in self.rows) + self.missing

    @property
    def apart_of(self) -> int:
        """Measures by which they could have been."""
        return sum(row.apart is not None for row in self.rows) + self.missing

    def json(self) -> str:
        """As benchmark.json holds it."""
        return as_json(self.rows, self.facts)


class Paired:
    """The tallies of some motions and of the truth under the same sounds."""

    def __init__(self) -> None:
        self._tallies: tuple[Tally, Tally] | None = None

    def add(self, one: Counted) -> None:
        """Count a sound."""
        ours, theirs = self._tallies = self._tallies or (Tally(one.fps), Tally(one.fps))
        ours.add(one.sums, one.features)
        theirs.add(one.true_sums, one.true_features)

    def table(self, settings: BootstrapSettings) -> Table:
        """Over all sounds; without sounds there is no row."""
        if self._tallies is None:
            return Table([], 0, {"sounds": 0})
        ours, theirs = self._tallies
        comparison = Comparison(ours, theirs, settings, paired=True)
        return Table(list(comparison.rows()), len(comparison.missing()), {"sounds": ours.clips, "fps": ours.fps})
