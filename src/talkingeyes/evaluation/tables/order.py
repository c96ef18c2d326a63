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
from talkingeyes.evaluation.seeds import Seeded


@dataclass(frozen=True)
class Pair:
    """Two rows: `above` has the greater number in the paper; our difference, `above` less `below`."""

    above: str
    below: str
    difference: Estimate

    @property
    def agrees(self) -> bool:
        """Whether ours has the same sign."""
        return self.difference.value > 0

    @property
    def clear(self) -> bool:
        """Whether ours has a sign at all, given its clips."""
        return self.difference.low > 0 or self.difference.high < 0


@dataclass(frozen=True)
class Order:
    """The pairs of a column."""

    pairs: tuple[Pair, ...]

    @property
    def agreeing(self) -> int:
        """How many are in the paper's order."""
        return sum(pair.agrees for pair in self.pairs)

    @property
    def tau(self) -> float:
        """Kendall's tau: pairs that agree less pairs that are reversed, over all; equal ones count for neither."""
        reversed_ = sum(pair.difference.value < 0 for pair in self.pairs)
        return (self.agreeing - reversed_) / len(self.pairs)

    @property
    def same(self) -> bool:
        """Whether all pairs agree."""
        return self.agreeing == len(self.pairs)


def order(paper: Mapping[str, float], ours: Mapping[str, Seeded], settings: BootstrapSettings) -> Order | None:
    """The order of a column; `paper` and `ours` by row. None with fewer than two rows in common."""
    rows = [name for name in paper if name in ours]
    pairs = []
    for one, other in combinations(rows, 2):
        if paper[one] == paper[other]:
            continue
        above, below = (one, other) if paper[one] > paper[other] else (other, one)
        pairs.append(Pair(above, below, _difference(ours[above], ours[below], settings)))
    return Order(tuple(pairs)) if pairs else None


def _difference(above: Seeded, below: Seeded, settings: BootstrapSettings) -> Estimate:
    assert above.count == below.count, "rows of a table are measured on the same sounds"
    return bootstrap(lambda drawn: above(drawn) - below(drawn), above.count, settings)
