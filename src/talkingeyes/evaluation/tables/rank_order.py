"""Agreement of the order of rows with the paper's order, by pairs of rows, with Kendall's tau.

A pair of rows agrees if our difference, as a mean over seeds, has the sign of the paper's. It is significant if the
interval of our difference over speakers excludes 0 on the same side in more than half of the seeds. The paper gives no
intervals, so all its pairs count; pairs with equal numbers in the paper have no order and are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from talkingeyes.evaluation.intervals import TableEstimate
from talkingeyes.evaluation.tables.definitions import PaperTable
from talkingeyes.evaluation.tables.seed_result import (
    Comparison,
    SeedMean,
    SplitResult,
    majority_sign,
    mean_over_seeds,
)


@dataclass(frozen=True)
class RowPair:
    """Two rows; `higher` has the greater number in the paper. `difference` is our `higher` minus `lower`."""

    higher: str
    lower: str
    difference: SeedMean
    is_significant: bool

    @property
    def agrees(self) -> bool:
        """Whether our difference has the sign of the paper's."""
        return self.difference.value > 0


@dataclass(frozen=True)
class RankOrder:
    """The ordered pairs of rows of a column."""

    pairs: tuple[RowPair, ...]

    @property
    def agreement_count(self) -> int:
        """Number of pairs in the paper's order."""
        return sum(pair.agrees for pair in self.pairs)

    @property
    def tau(self) -> float:
        """Kendall's tau: (agreeing minus reversed pairs) over all pairs; equal ones count for neither."""
        reversed_ = sum(pair.difference.value < 0 for pair in self.pairs)
        return (self.agreement_count - reversed_) / len(self.pairs)


def ordered_pairs(table: PaperTable, family: str, metric: str) -> list[Comparison]:
    """The pairs of rows of a family that differ in the paper in a column; `higher` has the paper's greater number."""
    at = [column.metric for column in table.paper_columns].index(metric)
    paper = {
        own: numbers[at]
        for row, numbers in table.rows.items()
        if numbers is not None and (own := table.row_of(family, row)) is not None
    }
    return [
        Comparison(metric, *((one, other) if paper[one] > paper[other] else (other, one)))
        for one, other in combinations(paper, 2)
        if paper[one] != paper[other]
    ]


def rank_order(table: PaperTable, family: str, metric: str, seeds: Sequence[SplitResult]) -> RankOrder | None:
    """Rank order of a family in a column, over the seeds; None if no pair is measured in all of them."""
    pairs = []
    for pair in ordered_pairs(table, family, metric):
        differences = [each.differences[pair.key] for each in seeds if pair.key in each.differences]
        if differences and len(differences) == len(seeds):
            is_significant = majority_sign([sign(each) for each in differences]) != 0
            pairs.append(RowPair(pair.higher, pair.lower, mean_over_seeds(differences), is_significant))
    return RankOrder(tuple(pairs)) if pairs else None


def sign(difference: TableEstimate) -> int:
    """1 or -1 if the interval over speakers lies above or below 0, else 0."""
    return int(difference.speakers_low > 0) - int(difference.speakers_high < 0)
