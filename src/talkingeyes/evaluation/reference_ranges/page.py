"""The acceptance table for a terminal and as docs/reference_ranges.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from talkingeyes.evaluation.reference_ranges.clip_data import Measurement, no_measurement
from talkingeyes.evaluation.reference_ranges.measurements import Measurements
from talkingeyes.evaluation.reference_ranges.ranges import RANGES_BY_SECTION, REFERENCE_RANGES, ReferenceRange

RECORDING_TITLES = {
    "T": "eye tracking at 500 Hz of people who look at pictures and films, head on a chin rest (Andersson et al. 2017)",
    "C": "fixations of people who speak in remote conversation, steps of a degree or more (Dembinsky et al. 2024)",
    "V": "faces in video at 30 frames a second, by OpenFace: eye angles are rough and the head is noisy",
}
# Why no recording at hand has a figure, by room of the table.
NOT_RECORDED_REASONS = {
    "Saccades": "too few saccades of that size, or not in these recordings",
    "Eyes": "one direction of gaze stands for both eyes; no onset of a head movement can be timed to 20 ms",
    "Looking": "no recording says where the partner is",
    "Head": "no recording of heads comes with its sound",
    "Blinks": "no recording has lids",
    "Lids and jaw": "no recording has lids or jaw",
    "Sound and motion": "no recording of gaze comes with its sound, nor twice with the same one",
    "Fitting": "nobody knows the true pupils of people",
}
PLOT_CAPTIONS = {
    "main-sequence": "Peak speed by amplitude at four frame rates. Dashed: the law; line: as that rate shows it.",
    "distributions": "Amplitudes, directions, and dwells at the partner and away. Grey: people (dark C, light T).",
    "timeline": "One clip: sound and words, gaze in space with its states, head, blinks.",
}
NOT_MEASURED = no_measurement("not measured")


def range_status(reference_range: ReferenceRange, found: Measurement) -> str:
    """in, OUT, or a dash where there is no figure."""
    if found.value is None:
        return "-"
    return "in" if reference_range.contains(found.value) else "OUT"


def status_counts(found: Measurements) -> str:
    """How many rows are in, out, and without a figure."""
    verdicts = [
        range_status(reference_range, found.get(reference_range.name, NOT_MEASURED))
        for reference_range in REFERENCE_RANGES
    ]
    return f"{verdicts.count('in')} in, {verdicts.count('OUT')} out, {verdicts.count('-')} without a figure"


def as_text(found: Measurements, recorded: Mapping[str, Measurements]) -> str:
    """For a terminal."""
    lines = []
    for title, ranges in RANGES_BY_SECTION.items():
        rows = [
            _cells(reference_range, found.get(reference_range.name, NOT_MEASURED), recorded)
            for reference_range in ranges
        ]
        lines += [
            "",
            title,
            *_aligned([("", "statistic", "target", "band", "measured", "of", "people", "source"), *rows]),
        ]
    return "\n".join([*lines, "", status_counts(found), *_people_lines(recorded)])


def _cells(
    reference_range: ReferenceRange, found: Measurement, recorded: Mapping[str, Measurements]
) -> tuple[str, ...]:
    measurement = "-" if found.value is None else format_number(found.value)
    of = found.reason or f"{found.count} {found.count_unit}"
    return (
        range_status(reference_range, found),
        label(reference_range),
        reference_range.published,
        range_text(reference_range),
        measurement,
        of,
        _people(reference_range, recorded),
        reference_range.source,
    )


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def markdown(found: Measurements, recorded: Mapping[str, Measurements], what: str, pictures: Mapping[str, str]) -> str:
    """The page. `pictures`: names of PICTURES with their paths from the page."""
    lines = [
        "# Reference ranges",
        "",
        "Written by `make reference-ranges`: how eyes, head, lids and jaw of people move in speech, the range that a"
        " corpus must meet, and its values. A range tests the generator, not nature; where a range was changed,"
        " the old one is in brackets with the reason. Certainty of sources: S* seen, S well known, R recalled, U a"
        " prior, D a choice, M computed. How each value is measured: `src/talkingeyes/evaluation/reference_ranges/`.",
        "",
        f"Corpus: {what}. **{status_counts(found)}.**",
    ]
    for title, ranges in RANGES_BY_SECTION.items():
        lines += [
            "",
            f"## {title}",
            "",
            "| statistic | target | band | measured | | of | people | source |",
            "|---|---|---|---|---|---|---|---|",
        ]
        lines += [
            _row(reference_range, found.get(reference_range.name, NOT_MEASURED), recorded) for reference_range in ranges
        ]
    lines += ["", "## Recorded people", "", *_people_lines(recorded), "", *_reasons(recorded)]
    for name, path in pictures.items():
        lines += ["", f"![{PLOT_CAPTIONS[name]}]({path})", "", PLOT_CAPTIONS[name]]
    return "\n".join([*lines, ""])


def _row(reference_range: ReferenceRange, found: Measurement, recorded: Mapping[str, Measurements]) -> str:
    state, *cells = (cell.replace("|", "\\|") for cell in _cells(reference_range, found, recorded))
    statistic, published, bounds, measurement, of, people, source = cells
    bounds = f"{bounds} ({reference_range.previous_range})" if reference_range.previous_range else bounds
    state = "**out**" if state == "OUT" else state
    return f"| {statistic} | {published} | {bounds} | {measurement} | {state} | {of} | {people} | {source} |"


def label(reference_range: ReferenceRange) -> str:
    """The statistic and its unit."""
    return f"{reference_range.statistic}, {reference_range.unit}" if reference_range.unit else reference_range.statistic


def range_text(reference_range: ReferenceRange) -> str:
    """Its bounds in words."""
    if reference_range.low == -float("inf"):
        return f"<= {reference_range.high:g}"
    if reference_range.high == float("inf"):
        return f">= {reference_range.low:g}"
    return (
        f"{reference_range.low:g} to {reference_range.high:g}"
        if reference_range.low < reference_range.high
        else f"{reference_range.low:g}"
    )


def _people(reference_range: ReferenceRange, recorded: Mapping[str, Measurements]) -> str:
    shown = [(name, found.get(reference_range.name)) for name, found in recorded.items()]
    return (
        "; ".join(f"{name} {format_number(each.value)}" for name, each in shown if each and each.value is not None)
        or "-"
    )


def _people_lines(recorded: Mapping[str, Measurements]) -> list[str]:
    if not recorded:
        return ["No recordings of people here."]
    return [f"- {name}: {RECORDING_TITLES[name]}" for name in recorded]


def _reasons(recorded: Mapping[str, Measurements]) -> list[str]:
    """Where people have a dash, why."""
    lines = ["Where people have a dash:", ""] if recorded else []
    for title, ranges in RANGES_BY_SECTION.items():
        if recorded and any(_people(reference_range, recorded) == "-" for reference_range in ranges):
            lines.append(f"- {title}: {NOT_RECORDED_REASONS[title]}")
    return lines


def format_number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.0e}"
