"""Metrics of a row of the paper's tables, and results of a table with one training seed: cells and their differences.

Results are one file per table and seed (tables_seeds/TABLE-SEED.json), complete in itself, so that seeds computed at
different times and on different machines make one page. Sounds are not kept: means and limits of several seeds are
means over seeds.

Table II of the paper describes in words how far VAE and VQ-VAE let a part move ("nearly stationary", "exaggerated").
Here it is measured: the range of a motion is the middle 95 % of each rotation component, averaged over components
(pitch and yaw of the eyes, all three of the head) and samples, next to the range of the truth for the same sounds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.stats import norm, sem, t

from talkingeyes.core.kinematics import still_fraction
from talkingeyes.evaluation.bootstrap import (
    BootstrapSettings,
    SoundStatistic,
    TableEstimate,
    difference,
    estimate,
    mean_of_known,
    ratio_of_known,
)
from talkingeyes.evaluation.papers.posegan_movement import jitter
from talkingeyes.evaluation.papers.talkingeyes_metrics import ClipMetrics, EvaluationCase, rotation_vectors
from talkingeyes.evaluation.papers.talkingeyes_tables import REFERENCES, PaperTable

# {row: {metric: ...}} in one split.
RowStatistics = Mapping[str, Mapping[str, SoundStatistic]]
RowEstimates = Mapping[str, Mapping[str, TableEstimate]]


@dataclass(frozen=True)
class Comparison:
    """Two rows in one metric: `factor` times `higher`, minus `lower`."""

    metric: str
    higher: str
    lower: str
    factor: float = 1.0

    @property
    def key(self) -> str:
        """Its name in a file of results."""
        return f"{self.metric}: {self.factor:g} {self.higher} - {self.lower}"


@dataclass(frozen=True)
class SplitResult:
    """Estimates of one split: cells by row and metric, differences by `Comparison.key`."""

    rows: RowEstimates
    differences: Mapping[str, TableEstimate]


@dataclass(frozen=True)
class SeedResult:
    """Results of one table with one seed of training and sampling.

    `configuration`: hash of the settings of all rows; `budgets`: the training of each row in words; `splits` by name.
    """

    table: str
    seed: int
    configuration: str
    revision: str
    budgets: Mapping[str, str]
    splits: Mapping[str, SplitResult]


@dataclass(frozen=True)
class SeedMean(TableEstimate):
    """Means over seeds of value and limits, and the range of the value over seeds."""

    seed_min: float
    seed_max: float


def split_result(
    table: PaperTable, rows: RowStatistics, comparisons: Iterable[Comparison], settings: BootstrapSettings
) -> SplitResult:
    """Estimate the cells of a table in one split, and all comparisons whose rows have the metric."""
    cells = {
        name: {
            each.metric: estimate(rows[name][each.metric], settings)
            for each in table.columns
            if each.metric in rows[name]
        }
        for name in (*REFERENCES, *table.rows)
        if rows.get(name)
    }
    differences = {
        each.key: difference(rows[each.higher][each.metric], rows[each.lower][each.metric], settings, each.factor)
        for each in comparisons
        if all(each.metric in rows.get(row, {}) for row in (each.higher, each.lower))
    }
    return SplitResult(cells, differences)


def mean_over_seeds(estimates: Sequence[TableEstimate]) -> SeedMean:
    """Means of value and limits over seeds.

    The mean of the limits is about as wide as the interval of the mean value or wider: the standard deviation of a mean
    is at most the mean of the standard deviations.
    """
    values = [each.value for each in estimates]

    def mean(name: str) -> float:
        return float(np.mean([getattr(each, name) for each in estimates]))

    return SeedMean(
        mean("value"), mean("low"), mean("high"), mean("speakers_low"), mean("speakers_high"), min(values), max(values)
    )


def interval_with_seeds(estimates: Sequence[TableEstimate], level: float = 0.95) -> tuple[float, float]:
    """Interval of a mean over seeds, over speakers and seeds: the half-widths of both added as squares.

    Over speakers it is the mean of the seeds' limits (95 %), scaled as a normal one to another level; over seeds that
    of Student's t, and of no width with one seed.
    """
    mean, values = mean_over_seeds(estimates), np.array([each.value for each in estimates])
    tail = (1 + level) / 2
    scale = norm.ppf(tail) / norm.ppf(0.975)
    seeds = t.ppf(tail, len(values) - 1) * sem(values) if len(values) > 1 else 0.0
    low, high = (
        math.hypot(scale * each, seeds) for each in (mean.value - mean.speakers_low, mean.speakers_high - mean.value)
    )
    return mean.value - low, mean.value + high


def to_json(result: SeedResult) -> dict[str, Any]:
    """The content of a file of results."""
    return asdict(result)


def from_json(content: Mapping[str, Any]) -> SeedResult:
    """The result of a file. Raises KeyError or TypeError if `content` has other keys than those of `to_json`."""
    return SeedResult(**{**content, "splits": {name: _split(each) for name, each in content["splits"].items()}})


def _split(content: Mapping[str, Any]) -> SplitResult:
    rows = {row: _estimates(metrics) for row, metrics in content["rows"].items()}
    return SplitResult(rows, _estimates(content["differences"]))


def _estimates(content: Mapping[str, Any]) -> dict[str, TableEstimate]:
    return {name: TableEstimate(**each) for name, each in content.items()}


RANGE_TAILS = (0.025, 0.975)
MEANS = ("diversity", "corr", "l2", "speed", "still_fraction")
# {ratio: (numerator, denominator)}.
RATIOS = {
    "diversity_ratio": ("diversity", "diversity_truth"),
    "speed_ratio": ("speed", "speed_truth"),
    "range_ratio": ("range", "range_truth"),
}
# {part/metric: value} of one sound or of one long motion.
SoundMetrics = Mapping[str, float]


def sound_metrics(case: EvaluationCase, figures: Mapping[str, ClipMetrics]) -> dict[str, float]:
    """Metrics of one sound that are stored for the tables."""
    found: dict[str, float] = {}
    for part, each in figures.items():
        own = {name: getattr(each, name) for name in ("diversity", "diversity_truth", "corr", "l2")}
        own |= {"speed": float(each.speed.mean()), "speed_truth": float(each.speed_truth.mean())}
        own |= {"still_fraction": float(still_fraction(each.speed))}
        if part != "gaze_in_space":
            own |= {"range": range_rad(rotating_components(part, rotation_vectors(part, case.samples)))}
            own |= {
                "range_truth": range_rad(rotating_components(part, rotation_vectors(part, case.truth or case.fitted)))
            }
        found |= {f"{part}/{name}": float(value) for name, value in own.items()}
    return found


def rotating_components(part: str, motion: Float[ndarray, "S T C"]) -> Float[ndarray, "S T D"]:
    """Components that rotate: all three of the head, pitch and yaw of each eye (eyes have no torsion)."""
    return motion if part == "head" else motion[..., [0, 1, 3, 4]]


def range_rad(motion: Float[ndarray, "S T C"]) -> float:
    """Range from the 2.5th to the 97.5th percentile over frames, as a mean over components and samples."""
    low, high = np.quantile(motion, RANGE_TAILS, axis=1)
    return float((high - low).mean())


def high_frequency_motion(head: Float[ndarray, "T 3"], gaze: Float[ndarray, "T 2 3"], fps: float) -> dict[str, float]:
    """Motion above 5 Hz of a long clip: root mean square of that part of velocity, and its fraction of the power."""
    found: dict[str, float] = {}
    for part, motion in (("head", head), ("gaze", gaze.reshape(len(gaze), 6)[:, [0, 1, 3, 4]])):
        share = jitter([motion], fps)
        speed = np.diff(motion, axis=0) * fps
        deg_s = math.degrees(math.sqrt(share * ((speed - speed.mean(0)) ** 2).mean()))
        found |= {f"{part}/speed_above_5hz": deg_s, f"{part}/power_fraction_above_5hz": share}
    return found


def row_metrics(row: Mapping[str, Any], split: str) -> dict[str, SoundStatistic]:
    """All metrics of a row, with one seed, in a split.

    `row` holds `sounds` and `long`: by split, a list of {"speaker": name, "metrics": SoundMetrics}.
    """
    return _of_sounds(row["sounds"].get(split, [])) | _of_long(row["long"].get(split, []))


def _of_sounds(sounds: Sequence[Mapping[str, Any]]) -> dict[str, SoundStatistic]:
    found: dict[str, SoundStatistic] = {}
    columns, speakers = _columns(sounds)
    for part in ("head", "gaze", "gaze_in_space"):
        for name in MEANS:
            values = columns.get(f"{part}/{name}")
            if values is not None and not np.isnan(values).all():
                found[f"{part}/{name}"] = mean_of_known(values, speakers)
        for name, (own, other) in RATIOS.items():
            values, reference = (columns.get(f"{part}/{each}") for each in (own, other))
            if values is not None and reference is not None and _is_defined(values, reference):
                found[f"{part}/{name}"] = ratio_of_known(values, reference, speakers)
    return found


def _of_long(motions: Sequence[Mapping[str, Any]]) -> dict[str, SoundStatistic]:
    columns, speakers = _columns(motions)
    return {name: mean_of_known(values, speakers) for name, values in columns.items()}


def _columns(measured: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Float[ndarray, " N"]], list[str]]:
    """{metric: values} of N sounds or motions, and their speakers."""
    names = measured[0]["metrics"] if measured else ()
    columns = {name: np.array([each["metrics"][name] for each in measured]) for name in names}
    return columns, [each["speaker"] for each in measured]


def _is_defined(values: Float[ndarray, " N"], reference: Float[ndarray, " N"]) -> bool:
    """Whether some sounds have both values, and no reference value among them is zero."""
    known = ~np.isnan(values + reference)
    return bool(known.any() and reference[known].all())
