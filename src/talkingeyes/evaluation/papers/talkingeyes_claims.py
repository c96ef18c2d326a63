"""What our rows say of TalkingEyes' Tables II, III, V, VI and VII: their claims, and the order of rows.

The order is compared by pairs of rows, with Kendall's tau. A pair of rows agrees if our difference, as a mean over
seeds, has the sign of the paper's. It is significant if the interval of our difference over speakers and seeds excludes
0. The paper gives no intervals, so all its pairs count; pairs with equal numbers in the paper have no order and are
left out.

A claim, judged for both families, is one or several comparisons of two rows in one column: the difference of the two
rows, as a mean over seeds, with its 95 % interval over speakers and seeds (`interval_with_seeds`).

- A difference: `reproduced` if the interval lies above 0, `not reproduced` if it lies below.
- No difference (`equal`): `reproduced` if the interval lies within TOLERANCE of the lower row's value, `not reproduced`
  if it lies outside.
- Otherwise `undecided`. A claim of several comparisons is reproduced if all are, and not reproduced if one is not.
- A verdict is firm if it holds with intervals at 1 - 0.05 / n, n the number of verdicts (Bonferroni).
- `undecided` in the columns of the eyes if the eyes of a compared row stand still in more than STILL_FRACTION of the
  frames, though the paper's move: two still rows decide nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from talkingeyes.evaluation.papers.talkingeyes_results import (
    Comparison,
    SeedMean,
    SplitResult,
    interval_with_seeds,
    mean_over_seeds,
)
from talkingeyes.evaluation.papers.talkingeyes_tables import SEQUENCE, TABLES, PaperTable


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
            low, high = interval_with_seeds(differences)
            pairs.append(RowPair(pair.higher, pair.lower, mean_over_seeds(differences), low > 0 or high < 0))
    return RankOrder(tuple(pairs)) if pairs else None


LEVEL = 0.95
REPRODUCED, NOT_REPRODUCED, UNDECIDED = "reproduced", "not reproduced", "undecided"
STILL_FRACTION = 0.5
# "No difference" is one of at most this fraction. The paper's numbers of the head in Table VII differ by 4 %.
TOLERANCE = 0.1
# Rows whose eyes stand still, or nearly, in the paper.
STILL_IN_PAPER = ("mean", "vae", "sequence_vae_gaze", "without_regularity")
NO_ROW, SAME_ROWS, NOT_MEASURED, STILL = "no such term", "the same rows", "not measured", "the eyes stand still"


@dataclass(frozen=True)
class Claim:
    """A claim of the paper: its words, the table of ours that decides it, and its comparisons of rows with regressed
    features.

    `equal`: the rows of a comparison are claimed not to differ; `not_judged`: why our rows can say nothing about it.
    """

    text: str
    source: str  # where the paper says so
    table: str
    comparisons: tuple[Comparison, ...]
    equal: bool = False
    not_judged: str = ""

    def comparisons_of(self, family: str) -> tuple[Comparison, ...] | None:
        """The comparisons between rows of a family; None if it lacks one of the rows."""
        table, found = TABLES[self.table], []
        for each in self.comparisons:
            higher, lower = (table.row_of(family, row) for row in (each.higher, each.lower))
            if higher is None or lower is None:
                return None
            found.append(replace(each, higher=higher, lower=lower))
        return tuple(found)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim, with its reason; `verdict` is empty if the family has nothing to compare."""

    verdict: str
    reason: str


BASELINES = ("mean", "random", "similar", "vae")
PAPER = "talkingeyes_paper"


def _above(metric: str, higher: str, *lower: str) -> tuple[Comparison, ...]:
    return tuple(Comparison(metric, higher, row) for row in lower)


def _velocity(what: str, metric: str, worse_is_higher: bool) -> Claim:
    rows = ("without_velocity", PAPER) if worse_is_higher else (PAPER, "without_velocity")
    return Claim(f"Without L_vel, {what}", "Table VI", "table6", (Comparison(metric, *rows),))


CLAIMS = (
    Claim(
        "The eyes of a VAE are nearly stationary (less than half of the truth's speed)",
        "Table II",
        "table5",
        (Comparison("gaze/speed", "truth", "vae", factor=0.5),),
    ),
    Claim(
        "The eyes of a VQ-VAE have a larger range than those of a VAE",
        "Table II",
        "table5",
        _above("gaze/range_ratio", PAPER, "vae"),
    ),
    Claim(
        "The head of a VQ-VAE is exaggerated (a larger range than the truth's)",
        "Table II",
        "table5",
        _above("head/range_ratio", "vqvae_head", "truth"),
    ),
    Claim(
        "TalkingEyes has the highest Diversity of the eyes",
        "Table III",
        "table3",
        _above("gaze/diversity", PAPER, *BASELINES),
    ),
    Claim("Its Diversity is above that of Random", "section V-C", "table3", _above("gaze/diversity", PAPER, "random")),
    Claim(
        "TalkingEyes has the highest Corr. of the eyes", "Table III", "table3", _above("gaze/corr", PAPER, *BASELINES)
    ),
    Claim("Its Corr. is above that of Similar Sample", "section V-C", "table3", _above("gaze/corr", PAPER, "similar")),
    Claim(
        "Its L2 of the eyes is above that of all baselines", "Table III", "table3", _above("gaze/l2", PAPER, *BASELINES)
    ),
    Claim(
        "A VAE performs like Mean (Corr. and L2 of the eyes)",
        "section V-C",
        "table3",
        (Comparison("gaze/corr", "vae", "mean"), Comparison("gaze/l2", "vae", "mean")),
        equal=True,
        not_judged="critics differ: the paper's gives a constant pose 0.457, ours about 0",
    ),
    Claim(
        "The eyes of a VQ-VAE have more Diversity than those of a VAE",
        "Table V",
        "table5",
        _above("gaze/diversity", PAPER, "vae"),
    ),
    Claim(
        "The eyes of a VQ-VAE have a higher Corr. than those of a VAE",
        "Table V",
        "table5",
        _above("gaze/corr", PAPER, "vae"),
    ),
    Claim(
        "The head of a VQ-VAE has more Diversity than that of a VAE",
        "Table V",
        "table5",
        _above("head/diversity", "vqvae_head", PAPER),
    ),
    Claim(
        "The head of a VQ-VAE has a lower Corr. than that of a VAE",
        "Table V",
        "table5",
        _above("head/corr", PAPER, "vqvae_head"),
    ),
    _velocity("the head jitters (motion above 5 Hz)", "head/speed_above_5hz", worse_is_higher=True),
    _velocity("the eyes jitter (motion above 5 Hz)", "gaze/speed_above_5hz", worse_is_higher=True),
    _velocity("Diversity of the head is lower", "head/diversity", worse_is_higher=False),
    _velocity("Diversity of the eyes is lower", "gaze/diversity", worse_is_higher=False),
    _velocity("Corr. of the head is lower", "head/corr", worse_is_higher=False),
    _velocity("Corr. of the eyes is lower", "gaze/corr", worse_is_higher=False),
    _velocity("L2 of the head is higher", "head/l2", worse_is_higher=True),
    _velocity("L2 of the eyes is higher", "gaze/l2", worse_is_higher=True),
    Claim(
        "Without L_reg, the eyes stand still",
        "Table VI",
        "table6",
        (
            Comparison("gaze/still_fraction", "without_regularity", PAPER),
            Comparison("gaze/diversity", PAPER, "without_regularity"),
        ),
    ),
    Claim(
        "Fewer codes give the eyes more Diversity (256 against 2,048)",
        "Table VII",
        "table7",
        _above("gaze/diversity", "regressed_256", "regressed_2048"),
    ),
    Claim(
        "Fewer codes give the eyes a lower Corr. (256 against 2,048)",
        "Table VII",
        "table7",
        _above("gaze/corr", "regressed_2048", "regressed_256"),
    ),
    Claim(
        "The number of codes does not affect the head (Diversity and Corr., 256 against 2,048)",
        "Table VII",
        "table7",
        (
            Comparison("head/diversity", "regressed_256", "regressed_2048"),
            Comparison("head/corr", "regressed_256", "regressed_2048"),
        ),
        equal=True,
        not_judged="true by construction: no head sees the codes",
    ),
)


def judge(claim: Claim, family: str, seeds: Sequence[SplitResult], level: float = LEVEL) -> Verdict:
    """The verdict of a family's rows on a claim, from one split of its table under several seeds, by intervals of a
    confidence level."""
    comparisons = claim.comparisons_of(family)
    if comparisons is None:
        return Verdict("", NO_ROW)
    if claim.not_judged:
        return Verdict("", claim.not_judged)
    if family == SEQUENCE and comparisons == claim.comparisons:
        return Verdict("", SAME_ROWS)
    verdicts = [_judge(each, claim.equal, seeds, level) for each in comparisons]
    for wanted in (NOT_REPRODUCED, UNDECIDED):
        found = next((each for each in verdicts if each.verdict == wanted), None)
        if found is not None:
            return found
    return Verdict(REPRODUCED, "<br>".join(each.reason for each in verdicts))


def _judge(comparison: Comparison, equal: bool, seeds: Sequence[SplitResult], level: float) -> Verdict:
    differences = [each.differences[comparison.key] for each in seeds if comparison.key in each.differences]
    if not seeds or len(differences) < len(seeds):
        return Verdict(UNDECIDED, NOT_MEASURED)
    if _stands_still(comparison, seeds):
        return Verdict(UNDECIDED, STILL)
    low, high = interval_with_seeds(differences, level)
    if equal:
        values = [abs(each.rows[comparison.lower][comparison.metric].value) for each in seeds]
        most = TOLERANCE * float(np.mean(values))
        sign = int(-most <= low and high <= most) - int(low > most or high < -most)
    else:
        sign = int(low > 0) - int(high < 0)
    factor = "" if comparison.factor == 1 else f"{comparison.factor:g} × "
    value = mean_over_seeds(differences).value
    return Verdict(
        {1: REPRODUCED, -1: NOT_REPRODUCED, 0: UNDECIDED}[sign],
        f"{value:+.3f} ({low:+.3f} to {high:+.3f}), {factor}`{comparison.higher}` − `{comparison.lower}`",
    )


def _stands_still(comparison: Comparison, seeds: Sequence[SplitResult]) -> bool:
    """Whether a compared row's eyes stand still, though the paper's move, in a column of the eyes."""
    if comparison.metric.startswith("head/"):
        return False
    fractions = [
        float(np.mean([each.rows[row]["gaze/still_fraction"].value for each in seeds]))
        for row in (comparison.higher, comparison.lower)
        if row not in STILL_IN_PAPER
    ]
    return max(fractions, default=0.0) > STILL_FRACTION
