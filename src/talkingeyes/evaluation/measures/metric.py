"""Definition of a benchmark metric: sums over a clip, and a value computed from the sums over many clips.

An extractor turns one behaviour into named sums (counts, histograms, products, curves). A metric computes its value
from the totals over all clips. Each clip is therefore read once, memory does not grow with the number of clips, and a
resample of the clips is a weighted sum: the bootstrap costs one matrix product for all metrics together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.evaluation.bootstrap import Statistic
from talkingeyes.evaluation.detectors.behaviour import still_motions
from talkingeyes.evaluation.measures.distribution import WindowFeatures

# Rounding errors in the speeds and squares of a still motion sum to 1e-11 or less; those of real motion to far more.
ZERO_TOLERANCE = 1e-9
# Sums of one clip: a number or an array for each name.
Sums = Mapping[str, "int | float | np.integer | ndarray"]
# Totals of D resamples of the clips: (D,) or (D, K) for each name.
Totals = Mapping[str, ndarray]

Direction = Literal["closer", "lower", "higher"]
CLOSER: Final = "closer"
LOWER: Final = "lower"
HIGHER: Final = "higher"


@dataclass(frozen=True)
class Extractor:
    """A group of sums that are computed together.

    `needs` names the required fields of Behaviour. `extract` takes one Behaviour, or with `together` the sequence of
    all motions of a sound. A sum has the same length for all motions; one without values may be left out.
    """

    extract: Callable[..., Sums]
    needs: tuple[str, ...]
    together: bool = False

    @cached_property
    def sizes(self) -> dict[str, int]:
        """The length of each sum, found by extracting the sums of still motions."""
        motions = still_motions()
        return {name: np.size(value) for name, value in self.extract(motions if self.together else motions[0]).items()}


@dataclass(frozen=True)
class Metric:
    """A metric of the benchmark, with everything that its documentation page shows.

    `count_key` names the sum that counts the events (or frames, or clips) behind the value; `min_count` is their
    minimum number. `direction` says what is better: "closer" to the reference, "lower" or "higher". Exactly one of
    three functions is given. `compute` takes the totals of the motions. `compare` takes the totals of the motions and
    of the reference. `pairwise` takes windows of both (resampled together, with a flag that clip i of both is the same
    sound). For the last two the reference value is the comparison of two halves of the reference. Metrics with
    `rate_dependent` depend on the frame rate and are not compared across frame rates.
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
        """What `count_key` counts, in words: the last part of the key."""
        return self.count_key.split(".")[-1].replace("_", " ")


def ratio(numerator: str, denominator: str, scale: float = 1.0) -> Callable[[Totals], Float[ndarray, " D"]]:
    """Function that divides one total by another, times `scale`."""
    return lambda totals: safe_divide(scale * totals[numerator], totals[denominator])


def variation(name: str) -> Callable[[Totals], Float[ndarray, " D"]]:
    """Function that gives the coefficient of variation of values by their number, sum and sum of squares (`name`s,
    `name`_s, `name`_s2)."""

    def compute(totals: Totals) -> Float[ndarray, " D"]:
        mean = safe_divide(totals[f"{name}_s"], totals[f"{name}s"])
        square = safe_divide(totals[f"{name}_s2"], totals[f"{name}s"])
        return safe_divide(np.sqrt(np.maximum(square - mean**2, 0)), mean)

    return compute


def safe_divide(numerator: Float[ndarray, "*D"], denominator: Float[ndarray, "*D"]) -> Float[ndarray, "*D"]:
    """Quotient, or NaN where the denominator is at most ZERO_TOLERANCE (nothing counted, or no motion)."""
    known = np.asarray(denominator) > ZERO_TOLERANCE
    return np.asarray(np.divide(numerator, denominator, out=np.full(np.shape(numerator), np.nan), where=known))


@dataclass(frozen=True)
class Bins:
    """A histogram of `count` equal bins from `low` to `high`; values outside count in the first or last bin."""

    low: float
    high: float
    count: int

    @property
    def edges(self) -> Float[ndarray, " K"]:
        return np.linspace(self.low, self.high, self.count + 1)

    def __call__(self, values: Float[ndarray, " N"]) -> Float[ndarray, " K"]:
        """Count the values in each bin."""
        index = ((values - self.low) * (self.count / (self.high - self.low))).astype(int)
        return np.bincount(np.clip(index, 0, self.count - 1), minlength=self.count).astype(float)

    def fraction_below(self, counts: Float[ndarray, "D K"], limit: float) -> Float[ndarray, " D"]:
        """Fraction of values below `limit`, which should be an edge of a bin."""
        reach = round((limit - self.low) / (self.high - self.low) * self.count)
        return safe_divide(counts[:, :reach].sum(axis=1), counts.sum(axis=1))

    def quantile(self, counts: Float[ndarray, "D K"], share: float) -> Float[ndarray, " D"]:
        """Quantile `share` (0 to 1) of the values; values within a bin are taken as evenly distributed."""
        below = np.cumsum(counts, axis=1)
        wanted = share * below[:, -1]
        index = np.minimum((below < wanted[:, None]).sum(axis=1), self.count - 1)
        draw = np.arange(len(counts))
        inside = safe_divide(wanted - below[draw, index] + counts[draw, index], counts[draw, index])
        return np.asarray(self.low + (index + inside) * (self.high - self.low) / self.count)

    def distance(self, one: Float[ndarray, "D K"], other: Float[ndarray, "E K"]) -> Float[ndarray, " D"]:
        """Wasserstein distance, the area between the distribution functions, in standard deviations of `other`."""
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
