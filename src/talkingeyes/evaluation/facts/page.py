"""The acceptance table for a terminal and as docs/facts.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from talkingeyes.evaluation.facts.acceptance import FACTS, TABLE, Fact
from talkingeyes.evaluation.facts.clip import Measured, missing
from talkingeyes.evaluation.facts.figures import Figures

PEOPLE = {
    "T": "eye tracking at 500 Hz of people who look at pictures and films, head on a chin rest (Andersson et al. 2017)",
    "C": "fixations of people who speak in remote conversation, steps of a degree or more (Dembinsky et al. 2024)",
    "V": "faces in video at 30 frames a second, by OpenFace: eye angles are rough and the head is noisy",
}
# Why no recording at hand has a figure, by room of the table.
NOT_RECORDED = {
    "Saccades": "too few saccades of that size, or not in these recordings",
    "Eyes": "one direction of gaze stands for both eyes; no onset of a head movement can be timed to 20 ms",
    "Looking": "no recording says where the partner is",
    "Head": "no recording of heads comes with its sound",
    "Blinks": "no recording has lids",
    "Lids and jaw": "no recording has lids or jaw",
    "Sound and motion": "no recording of gaze comes with its sound, nor twice with the same one",
    "Fitting": "nobody knows the true pupils of people",
}
PICTURES = {
    "main-sequence": "Peak speed by amplitude at four frame rates. Dashed: the law; line: as that rate shows it.",
    "distributions": "Amplitudes, directions, and dwells at the partner and away. Grey: people (dark C, light T).",
    "timeline": "One clip: sound and words, gaze in space with its states, head, blinks.",
}
NOTHING = missing("not measured")


def verdict(fact: Fact, found: Measured) -> str:
    """in, OUT, or a dash where there is no figure."""
    if found.value is None:
        return "-"
    return "in" if fact.met(found.value) else "OUT"


def counts(found: Figures) -> str:
    """How many rows are in, out, and without a figure."""
    verdicts = [verdict(fact, found.get(fact.name, NOTHING)) for fact in FACTS]
    return f"{verdicts.count('in')} in, {verdicts.count('OUT')} out, {verdicts.count('-')} without a figure"


def as_text(found: Figures, recorded: Mapping[str, Figures]) -> str:
    """For a terminal."""
    lines = []
    for title, facts in TABLE.items():
        rows = [_cells(fact, found.get(fact.name, NOTHING), recorded) for fact in facts]
        lines += [
            "",
            title,
            *_aligned([("", "statistic", "target", "band", "measured", "of", "people", "source"), *rows]),
        ]
    return "\n".join([*lines, "", counts(found), *_people_lines(recorded)])


def _cells(fact: Fact, found: Measured, recorded: Mapping[str, Figures]) -> tuple[str, ...]:
    measured = "-" if found.value is None else number(found.value)
    of = found.reason or f"{found.count} {found.counted}"
    return (
        verdict(fact, found),
        named(fact),
        fact.target,
        band(fact),
        measured,
        of,
        _people(fact, recorded),
        fact.source,
    )


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def markdown(found: Figures, recorded: Mapping[str, Figures], what: str, pictures: Mapping[str, str]) -> str:
    """The page. `pictures`: names of PICTURES with their paths from the page."""
    lines = [
        "# Facts",
        "",
        "Written by `make facts`: how eyes, head, lids and jaw of people move in speech, the band that a corpus must"
        " meet, and what this corpus has. A band tests the generator, not nature; where one was changed, the old one"
        " stands in brackets with the reason. Certainty of sources: S* seen, S well known, R recalled, U a prior,"
        " D a choice, M computed. How each figure is read: `src/talkingeyes/evaluation/facts/`.",
        "",
        f"Corpus: {what}. **{counts(found)}.**",
    ]
    for title, facts in TABLE.items():
        lines += [
            "",
            f"## {title}",
            "",
            "| statistic | target | band | measured | | of | people | source |",
            "|---|---|---|---|---|---|---|---|",
        ]
        lines += [_row(fact, found.get(fact.name, NOTHING), recorded) for fact in facts]
    lines += ["", "## Recorded people", "", *_people_lines(recorded), "", *_reasons(recorded)]
    for name, path in pictures.items():
        lines += ["", f"![{PICTURES[name]}]({path})", "", PICTURES[name]]
    return "\n".join([*lines, ""])


def _row(fact: Fact, found: Measured, recorded: Mapping[str, Figures]) -> str:
    state, *cells = (cell.replace("|", "\\|") for cell in _cells(fact, found, recorded))
    statistic, target, bounds, measured, of, people, source = cells
    bounds = f"{bounds} ({fact.was})" if fact.was else bounds
    state = "**out**" if state == "OUT" else state
    return f"| {statistic} | {target} | {bounds} | {measured} | {state} | {of} | {people} | {source} |"


def named(fact: Fact) -> str:
    """The statistic and its unit."""
    return f"{fact.statistic}, {fact.unit}" if fact.unit else fact.statistic


def band(fact: Fact) -> str:
    """Its bounds in words."""
    if fact.low == -float("inf"):
        return f"<= {fact.high:g}"
    if fact.high == float("inf"):
        return f">= {fact.low:g}"
    return f"{fact.low:g} to {fact.high:g}" if fact.low < fact.high else f"{fact.low:g}"


def _people(fact: Fact, recorded: Mapping[str, Figures]) -> str:
    shown = [(name, found.get(fact.name)) for name, found in recorded.items()]
    return "; ".join(f"{name} {number(each.value)}" for name, each in shown if each and each.value is not None) or "-"


def _people_lines(recorded: Mapping[str, Figures]) -> list[str]:
    if not recorded:
        return ["No recordings of people here."]
    return [f"- {name}: {PEOPLE[name]}" for name in recorded]


def _reasons(recorded: Mapping[str, Figures]) -> list[str]:
    """Where people have a dash, why."""
    lines = ["Where people have a dash:", ""] if recorded else []
    for title, facts in TABLE.items():
        if recorded and any(_people(fact, recorded) == "-" for fact in facts):
            lines.append(f"- {title}: {NOT_RECORDED[title]}")
    return lines


def number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.0e}"
