"""Whether the rows of a table stand in the paper's order: pair by pair, with Kendall's tau over the pairs.

A pair of rows agrees if ours differ in the paper's direction, otherwise it differs. It is clear if the interval of our
difference over clips (both rows drawn together, seeds averaged) does not hold 0. The paper gives no intervals, so all
its pairs count; pairs with equal numbers in the paper have no order and are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, bootstrap
from talkingeyes.evaluation.multi_seed import MultiSeedStatistic


@dataclass(frozen=True)
class RowPair:
    """Two rows: `higher` has the greater number in the paper; our difference, `higher` less `lower`."""

    higher: str
    lower: str
    difference: Estimate

    @property
    def agrees(self) -> bool:
        """Whether ours has the same sign."""
        return self.difference.value > 0

    @property
    def is_significant(self) -> bool:
        """Whether ours has a sign at all, given its clips."""
        return self.difference.low > 0 or self.difference.high < 0


@dataclass(frozen=True)
class RankOrder:
    """The pairs of a column."""

    pairs: tuple[RowPair, ...]

    @property
    def agreement_count(self) -> int:
        """How many are in the paper's order."""
        return sum(pair.agrees for pair in self.pairs)

    @property
    def tau(self) -> float:
        """Kendall's tau: pairs that agree less pairs that are reversed, over all; equal ones count for neither."""
        reversed_ = sum(pair.difference.value < 0 for pair in self.pairs)
        return (self.agreement_count - reversed_) / len(self.pairs)

    @property
    def all_agree(self) -> bool:
        """Whether all pairs agree."""
        return self.agreement_count == len(self.pairs)


def rank_order(
    paper: Mapping[str, float], ours: Mapping[str, MultiSeedStatistic], settings: BootstrapSettings
) -> RankOrder | None:
    """The order of a column; `paper` and `ours` by row. None with fewer than two rows in common."""
    rows = [name for name in paper if name in ours]
    pairs = []
    for one, other in combinations(rows, 2):
        if paper[one] == paper[other]:
            continue
        higher, lower = (one, other) if paper[one] > paper[other] else (other, one)
        pairs.append(RowPair(higher, lower, _difference(ours[higher], ours[lower], settings)))
    return RankOrder(tuple(pairs)) if pairs else None


def _difference(higher: MultiSeedStatistic, lower: MultiSeedStatistic, settings: BootstrapSettings) -> Estimate:
    assert higher.count == lower.count, "rows of a table are measured on the same sounds"
    return bootstrap(lambda drawn: higher(drawn) - lower(drawn), higher.count, settings)
