"""The table of reference ranges as text for a terminal and as Markdown cells."""

from __future__ import annotations

from collections.abc import Mapping

from talkingeyes.evaluation.measures.pooled import Measurement, no_measurement
from talkingeyes.evaluation.reference_ranges.measurements import Measurements
from talkingeyes.evaluation.reference_ranges.ranges import RANGES_BY_SECTION, REFERENCE_RANGES, ReferenceRange
from talkingeyes.evaluation.text_tables import aligned

RECORDING_TITLES = {
    "T": "eye tracking at 500 Hz of people viewing pictures and films, head on a chin rest (Andersson et al. 2017)",
    "C": "fixations of people speaking in remote conversation, steps of at least a degree (Dembinsky et al. 2024)",
    "V": "faces in video at 30 frames per second, by OpenFace: eye angles are inaccurate and head pose is noisy",
}
PLOT_CAPTIONS = {
    "main-sequence": "Peak speed by amplitude at four frame rates. Dashed: main sequence; line: sampled at that rate.",
    "distributions": "Amplitudes, directions, and dwell times of both gaze states. Grey: people (dark C, light T).",
    "timeline": "One clip: sound and words, gaze in space with its states, head, blinks.",
}
COLUMNS = ("statistic", "published", "range", "measured", "", "count", "recordings", "source")
NOT_MEASURED = no_measurement("not measured")


def range_status(reference_range: ReferenceRange, found: Measurement) -> str:
    """`within` or `outside` the range, or `-` without a value."""
    if found.value is None:
        return "-"
    return "within" if reference_range.contains(found.value) else "outside"


def status_counts(found: Measurements) -> str:
    """How many values are within their range, outside, and missing."""
    verdicts = [
        range_status(reference_range, found.get(reference_range.name, NOT_MEASURED))
        for reference_range in REFERENCE_RANGES
    ]
    return (
        f"{verdicts.count('within')} within, {verdicts.count('outside')} outside, {verdicts.count('-')} without a value"
    )


def as_text(found: Measurements, recorded: Mapping[str, Measurements]) -> str:
    """Text for a terminal."""
    lines = []
    for title, ranges in RANGES_BY_SECTION.items():
        rows = [
            _cells(reference_range, found.get(reference_range.name, NOT_MEASURED), recorded)
            for reference_range in ranges
        ]
        lines += [
            "",
            title,
            aligned([("", "statistic", "published", "range", "measured", "count", "recordings", "source"), *rows]),
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


def table_rows(found: Measurements, recorded: Mapping[str, Measurements]) -> dict[str, tuple[tuple[str, ...], ...]]:
    """Rows of Markdown cells under COLUMNS, by section of the table."""
    return {
        title: tuple(_row(each, found.get(each.name, NOT_MEASURED), recorded) for each in ranges)
        for title, ranges in RANGES_BY_SECTION.items()
    }


def _row(reference_range: ReferenceRange, found: Measurement, recorded: Mapping[str, Measurements]) -> tuple[str, ...]:
    state, *cells = (cell.replace("|", "\\|") for cell in _cells(reference_range, found, recorded))
    statistic, published, bounds, measurement, of, people, source = cells
    bounds = f"{bounds} ({reference_range.previous_range})" if reference_range.previous_range else bounds
    state = "**outside**" if state == "outside" else state
    return statistic, published, bounds, measurement, state, of, people, source


def label(reference_range: ReferenceRange) -> str:
    """The statistic and its unit."""
    return f"{reference_range.statistic}, {reference_range.unit}" if reference_range.unit else reference_range.statistic


def range_text(reference_range: ReferenceRange) -> str:
    """The bounds of the range as text."""
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
        return ["No recordings of people are available."]
    return [f"- {name}: {RECORDING_TITLES[name]}" for name in recorded]


def format_number(value: float) -> str:
    """Number with three significant digits."""
    return f"{value:.3g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.0e}"
