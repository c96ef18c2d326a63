"""Agreement of the order of rows with the paper's order, by pairs of rows, with Kendall's tau.

A pair of rows agrees if our difference has the sign of the paper's. It is significant if the interval of our difference
over clips (both rows resampled together, seeds averaged) excludes 0. The paper gives no intervals, so all its pairs
count; pairs with equal numbers in the paper have no order and are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap
from talkingeyes.evaluation.multi_seed import MultiSeedStatistic


@dataclass(frozen=True)
class RowPair:
    """Two rows; `higher` has the greater number in the paper. `difference` is our `higher` minus `lower`."""

    higher: str
    lower: str
    difference: Estimate

    @property
    def agrees(self) -> bool:
        """Whether our difference has the sign of the paper's."""
        return self.difference.value > 0

    @property
    def is_significant(self) -> bool:
        """Whether the interval of our difference excludes 0."""
        return self.difference.low > 0 or self.difference.high < 0


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

    @property
    def all_agree(self) -> bool:
        """Whether all pairs agree."""
        return self.agreement_count == len(self.pairs)


def rank_order(
    paper: Mapping[str, float], ours: Mapping[str, MultiSeedStatistic], settings: BootstrapSettings
) -> RankOrder | None:
    """Rank order of a column; `paper` and `ours` by row. None if no two common rows differ in the paper."""
    rows = [name for name in paper if name in ours]
    pairs = []
    for one, other in combinations(rows, 2):
        if paper[one] == paper[other]:
            continue
        higher, lower = (one, other) if paper[one] > paper[other] else (other, one)
        pairs.append(RowPair(higher, lower, _difference(ours[higher], ours[lower], settings)))
    return RankOrder(tuple(pairs)) if pairs else None


def _difference(higher: MultiSeedStatistic, lower: MultiSeedStatistic, settings: BootstrapSettings) -> Estimate:
    assert higher.count == lower.count, "rows of a table should be evaluated on the same sounds"
    return bootstrap(lambda resampled: higher(resampled) - lower(resampled), higher.count, settings)
