"""Results as Markdown in the layouts of the papers: preference rates, split percentages, or a column per length."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from talkingeyes.apps.study.design import Design
from talkingeyes.apps.study.results import ALL_STRATA, Preference
from talkingeyes.evaluation.text_tables import markdown_table


def table(design: Design, found: Sequence[Preference]) -> str:
    """The table in the design's layout; a dash where there are no answers."""
    by_key = {(each.a, each.b, each.question, each.stratum): each for each in found}
    layouts: Mapping[str, Callable[[Design, Mapping[tuple[str, str, str, str], Preference]], list[list[str]]]] = {
        "preference": _preference,
        "split": _split,
        "lengths": _lengths,
    }
    header, *rows = layouts[design.layout](design, by_key)
    return markdown_table(header, rows) + "\n"


def format_p_value(value: float) -> str:
    """A p-value as the papers write it: 1.68e-4."""
    if math.isnan(value):
        return "-"
    digits, exponent = f"{value:.2e}".split("e")
    return f"{digits}e{int(exponent)}"


def _preference(design: Design, by_key: Mapping[tuple[str, str, str, str], Preference]) -> list[list[str]]:
    """TalkingEyes, Table IV: A's percentage, and the p-value in brackets; a block of columns per question."""
    header = ["Method A vs. Method B"]
    for question in design.questions:
        title = "Preference Rate" if len(design.questions) == 1 else question.label
        header += [title, "95 %", "answers"]

    def cells(found: Preference) -> list[str]:
        interval = f"{100 * found.rate.low:.0f} to {100 * found.rate.high:.0f}"
        return [f"{100 * found.rate.value:.0f} ({_p(design, found)})", interval, str(found.answers)]

    return [header, *_rows(design, by_key, cells, ["-", "-", "0"])]


def _split(design: Design, by_key: Mapping[tuple[str, str, str, str], Preference]) -> list[list[str]]:
    """ProbTalk3D, Table 2: the percentages of A and B and the p-value, per question."""
    header = [""]
    for question in design.questions:
        header += [f"{question.label}, A", "B", "p"]

    def cells(found: Preference) -> list[str]:
        return [f"{100 * found.rate.value:.2f}%", f"{100 * (1 - found.rate.value):.2f}%", _p(design, found)]

    return [header, *_rows(design, by_key, cells, ["-", "-", "-"])]


def _rows(
    design: Design,
    by_key: Mapping[tuple[str, str, str, str], Preference],
    cells: Callable[[Preference], list[str]],
    unanswered: list[str],
) -> list[list[str]]:
    """One row per comparison: its title, then the cells of every question."""
    rows = []
    for a, b in design.comparisons:
        found = [by_key.get((a, b, question.name, ALL_STRATA)) for question in design.questions]
        blocks = [unanswered if each is None else cells(each) for each in found]
        rows.append([_title(design, a, b), *(cell for block in blocks for cell in block)])
    return rows


def _p(design: Design, found: Preference) -> str:
    """The p-value of the design's test."""
    return format_p_value(found.wilcoxon_p if design.test == "wilcoxon" else found.binomial_p)


def _lengths(design: Design, by_key: Mapping[tuple[str, str, str, str], Preference]) -> list[list[str]]:
    """PoseGAN, Table 4: how often A was preferred to the truth, a column per length of films."""
    question = design.questions[0].name
    strata = [stratum.name for stratum in design.strata]
    rows = [["Method", *(name.replace("_", " ") for name in strata)]]
    for a, b in design.comparisons:
        row = [design.conditions[a].label]
        for stratum in strata:
            found = by_key.get((a, b, question, stratum))
            if found is None:
                row.append("-")
                continue
            row.append(f"{100 * found.rate.value:.1f} ({100 * found.wilson_low:.0f} to {100 * found.wilson_high:.0f})")
        rows.append(row)
    return rows


def _title(design: Design, a: str, b: str) -> str:
    return f"{design.conditions[a].label} vs. {design.conditions[b].label}"
