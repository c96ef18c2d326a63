"""Preference rates of a study with p-values and intervals.

The rate is the fraction of answers that chose A. The Wilcoxon signed-rank test compares, per participant, the answers
for A minus those for B (TalkingEyes, section V-C.2, names the test but not its unit; answers of one person are
dependent, so the person is the unit here). The binomial test is exact and two-sided, over answers as if they were
independent. The interval is a bootstrap over participants; Wilson's interval over answers is also given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from talkingeyes.apps.study.answers import Answer
from talkingeyes.apps.study.design import Design
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate, percentile_interval, resample_indices

BOOTSTRAP = BootstrapSettings(n_resamples=2000, confidence_level=0.95, seed=0)
ALL_STRATA = "all"


@dataclass(frozen=True)
class Preference:
    """Rate of choosing A over B; p-values against no preference, nan if there is nothing to test.

    The Wilcoxon test uses all strata together, because a participant answers only once or twice per stratum.
    """

    a: str
    b: str
    question: str
    stratum: str
    answers: int
    participants: int
    rate: Estimate
    wilson_low: float
    wilson_high: float
    wilcoxon_p: float
    binomial_p: float
    left_rate: float


def preference_rates(design: Design, answers: Sequence[Answer]) -> list[Preference]:
    """Results of each comparison and question, over all strata and per stratum, where there are answers."""
    strata = [ALL_STRATA, *(stratum.name for stratum in design.strata)] if len(design.strata) > 1 else [ALL_STRATA]
    found = []
    for a, b in design.comparisons:
        for question in design.questions:
            for stratum in strata:
                chosen = [
                    each
                    for each in answers
                    if (each.a, each.b, each.question) == (a, b, question.name)
                    and stratum in (ALL_STRATA, each.stratum)
                ]
                if chosen:
                    found.append(_preference(a, b, question.name, stratum, chosen))
    return found


def _preference(a: str, b: str, question: str, stratum: str, chosen: Sequence[Answer]) -> Preference:
    from scipy.stats import binomtest

    people = sorted({each.participant for each in chosen})
    counts = np.zeros((len(people), 2), int)  # answers for A and for B, one row per participant
    for each in chosen:
        counts[people.index(each.participant), int(not each.chose_a)] += 1
    wins, total = int(counts[:, 0].sum()), int(counts.sum())
    exact = binomtest(wins, total)
    wilson = exact.proportion_ci(method="wilson")
    drawn = counts[resample_indices(len(people), BOOTSTRAP)]
    rate = Estimate(wins / total, *percentile_interval(drawn[:, :, 0].sum(axis=1) / drawn.sum(axis=(1, 2)), BOOTSTRAP))
    return Preference(
        a=a,
        b=b,
        question=question,
        stratum=stratum,
        answers=total,
        participants=len(people),
        rate=rate,
        wilson_low=float(wilson.low),
        wilson_high=float(wilson.high),
        wilcoxon_p=wilcoxon_p(counts[:, 0] - counts[:, 1]) if stratum == ALL_STRATA else math.nan,
        binomial_p=float(exact.pvalue),
        left_rate=sum(each.chose_a == each.a_left for each in chosen) / total,
    )


def wilcoxon_p(differences: Int[ndarray, " P"]) -> float:
    """Two-sided signed-rank test of differences against 0; nan if all are 0."""
    from scipy.stats import wilcoxon

    return float(wilcoxon(differences).pvalue) if differences.any() else math.nan
