"""What a measure is: sums over a clip, and a figure of the sums over many clips.

An observer turns one behaviour into named sums (counts, histograms, products, curves). A measure reads a figure off the
totals of all clips. So clips are seen once, memory does not grow with them, and a resample of the clips is a weighted
sum: the bootstrap costs one product of matrices for all measures together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import Statistic
from talkingeyes.evaluation.distribution.mmd import WindowFeatures

# Rounding leaves speeds and squares of a motion that stands still; they sum up to 1e-11 or less, real ones to far more.
ZERO_TOLERANCE = 1e-9
# Sums of one clip: a number, or an array, a name.
Sums = Mapping[str, "int | float | np.integer | ndarray"]
# Totals of D draws of the clips: (D,) or (D, K) a name.
Totals = Mapping[str, ndarray]

Direction = Literal["closer", "lower", "higher"]
CLOSER: Final = "closer"
LOWER: Final = "lower"
HIGHER: Final = "higher"


@dataclass(frozen=True)
class Extractor:
    """Sums that belong together. `needs` names fields of Behaviour; `sizes` says how long each sum is.

    `extract` takes one Behaviour; where `together`, the sequence of all motions of a sound.
    """

    extract: Callable[..., Sums]
    needs: tuple[str, ...]
    sizes: Mapping[str, int]
    together: bool = False


@dataclass(frozen=True)
class Metric:
    """A metric of the benchmark, with everything that its page shows.

    `count_key` names the sum that counts the events (or frames, or clips) behind the value, `min_count` their minimum
    number. `direction` is what is better: "closer" to the reference, "lower" or "higher". A metric with `compare` is
    computed against the totals of the reference; a `pairwise` one against windows of the reference (both resampled,
    with a flag whether clip i of both is the same sound), and its reference value is that between the reference's
    halves. `rate_dependent` metrics depend on the frame rate and are not compared across rates.
    """

    name: str
    title: str
    unit: str
    formula: str
    source: str
    caveat: str
    extractor: Extractor
    count_key: str
    min_count: int
    compute: Callable[[Totals], Float[ndarray, " D"]] | None = None
    compare: Callable[[Totals, Totals], Float[ndarray, " D"]] | None = None
    pairwise: Callable[[WindowFeatures, WindowFeatures, bool], Statistic] | None = None
    direction: Direction = CLOSER
    rate_dependent: bool = False

    def __post_init__(self) -> None:
        assert sum(each is not None for each in (self.compute, self.compare, self.pairwise)) == 1, self.name
        assert self.extractor.sizes[self.count_key] == 1, self.name

    @property
    def count_unit(self) -> str:
        """What `of` counts, in words: the end of its name."""
        return self.count_key.split(".")[-1].replace("_", " ")


def ratio(numerator: str, denominator: str, scale: float = 1.0) -> Callable[[Totals], Float[ndarray, " D"]]:
    """One total over another."""
    return lambda totals: safe_divide(scale * totals[numerator], totals[denominator])


def safe_divide(numerator: Float[ndarray, "*D"], denominator: Float[ndarray, "*D"]) -> Float[ndarray, "*D"]:
    """NaN where nothing was counted, or where nothing moved but for what rounding leaves (STANDS_STILL)."""
    known = np.asarray(denominator) > ZERO_TOLERANCE
    return np.asarray(np.divide(numerator, denominator, out=np.full(np.shape(numerator), np.nan), where=known))


@dataclass(frozen=True)
class Bins:
    """A histogram of even bins from `low` to `high`; what lies beyond counts in the last (or first)."""

    low: float
    high: float
    count: int

    @property
    def edges(self) -> Float[ndarray, " K"]:
        return np.linspace(self.low, self.high, self.count + 1)

    def __call__(self, values: Float[ndarray, " N"]) -> Float[ndarray, " K"]:
        """Counts of values."""
        index = ((values - self.low) * (self.count / (self.high - self.low))).astype(int)
        return np.bincount(np.clip(index, 0, self.count - 1), minlength=self.count).astype(float)

    def fraction_below(self, counts: Float[ndarray, "D K"], limit: float) -> Float[ndarray, " D"]:
        """Share of values below a limit that is an edge."""
        reach = round((limit - self.low) / (self.high - self.low) * self.count)
        return safe_divide(counts[:, :reach].sum(axis=1), counts.sum(axis=1))

    def quantile(self, counts: Float[ndarray, "D K"], share: float) -> Float[ndarray, " D"]:
        """The value that `share` of the values do not exceed; within a bin they count as even."""
        below = np.cumsum(counts, axis=1)
        wanted = share * below[:, -1]
        index = np.minimum((below < wanted[:, None]).sum(axis=1), self.count - 1)
        draw = np.arange(len(counts))
        inside = safe_divide(wanted - below[draw, index] + counts[draw, index], counts[draw, index])
        return np.asarray(self.low + (index + inside) * (self.high - self.low) / self.count)

    def distance(self, one: Float[ndarray, "D K"], other: Float[ndarray, "E K"]) -> Float[ndarray, " D"]:
        """Wasserstein distance in standard deviations of `other`: the area between the distribution functions."""
        shares = [
            safe_divide(counts, np.broadcast_to(counts.sum(axis=1, keepdims=True), counts.shape))
            for counts in (one, other)
        ]
        width = (self.high - self.low) / self.count
        centres = self.edges[:-1] + width / 2
        mean = shares[1] @ centres
        spread = np.sqrt(np.maximum(shares[1] @ centres**2 - mean**2, 0))
        area = np.abs(np.cumsum(shares[0] - shares[1], axis=1)).sum(axis=1) * width
        return safe_divide(area, np.broadcast_to(spread, area.shape))
