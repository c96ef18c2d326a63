"""Results of one table with one training seed: estimates of its cells, and of the differences that pages compare.

One file per table and seed (tables_seeds/TABLE-SEED.json), complete in itself, so that seeds computed at different
times and on different machines make one page. Sounds are not kept: means and limits of several seeds are means over
seeds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.intervals import SoundStatistic, TableEstimate, difference, estimate
from talkingeyes.evaluation.tables.definitions import REFERENCES, PaperTable

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


def majority_sign(signs: Sequence[int]) -> int:
    """The sign (-1 or 1) that more than half of the seeds have; 0 if none has."""
    return next((sign for sign in (-1, 1) if signs.count(sign) > len(signs) / 2), 0)


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
