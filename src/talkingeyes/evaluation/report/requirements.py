"""What a model of head and gaze must reach, for every row of the report.

Margins say that motion is like motion, whatever the sound; ties say that it follows its sound. Random and Mismatched
have the margins of true motion and no tie, a conditional mean the ties and no margins: only both together say
something, so a row is as good as what it misses. Motion that is looked up in the training data by its loudness can meet
both. What a model has learnt is therefore what it knows beyond the better of two lookups (models/replay.py).
All bounds are choices of this project.

`report_summary` is the report in at most 25 lines of plain text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.papers.table3 import SPLIT_TITLES, TITLES, MethodMetrics, metric, order_rows
from talkingeyes.evaluation.text_tables import markdown_table, training_sentence

# Margins as (title, part, metric, lowest, highest); ratios to the truth.
MARGINS = (
    ("Diversity of the eyes / truth", "gaze", "diversity_ratio", 0.8, 1.2),
    ("eye speed / truth", "gaze", "speed_ratio", 0.7, 1.3),
    ("99th percentile of eye speed / truth", "gaze", "speed_p99_ratio", 0.6, 1.4),
    ("Diversity of the head / truth", "head", "diversity_ratio", 0.8, 1.2),
    ("head speed / truth", "head", "speed_ratio", 0.7, 1.3),
)
# Fraction of frames with gaze in space still, relative to fitted motion, the training target.
REST_BOUNDS = (0.95, 1.05)
# Ties: Corr. less that under other sounds of the speaker, relative to fitted motion.
TIED_PARTS = {"gaze": "eyes", "gaze_in_space": "gaze in space", "head": "head"}
MIN_TIE = 0.6  # Similar Sample with 2,798 training sounds reaches 0.45 (0.35 to 0.56)
# Learnt: the whole interval lies beyond the better lookup's value.
LOOKUPS = ("aligned_replay", "pieced_replay")
LEARNT_DISTANCES = (
    ("distance of saccade amplitudes to the truth", "saccades/amplitude_distance"),
    ("distance of aversion durations to the truth", "partner_gaze/aversion_distance"),
)
TIE, MARGIN, LEARNT = "tie", "margin", "learnt"
KINDS = {TIE: "ties", MARGIN: "margins", LEARNT: "learnt"}
ONSET_DROP, ONSET_BOUNDS = "speech_onset/drop", (0.8, 1.2)
# What a face must show, relative to fitted motion; faces of other clips reach 0.13 and 0.36
# (docs/results/face_table.md).
FACE = (("emotion recognised", "emotion_accuracy", 0.6), ("lips closed at p, b and m", "bilabials_closed", 0.5))


@dataclass(frozen=True)
class Requirement:
    """A metric with its required bounds; `value` is None if it was not measured, `interval` if it has none.

    `kind`: a tie says that motion follows its sound, a margin only that it is like motion, `learnt` that it does so
    better than a lookup.
    """

    name: str
    value: float | None
    minimum: float = -math.inf
    maximum: float = math.inf
    interval: tuple[float, float] | None = None
    kind: str = MARGIN

    @property
    def is_met(self) -> bool:
        """Whether the value lies within the bounds."""
        return self.value is not None and self.minimum <= self.value <= self.maximum

    @property
    def is_missed_by_interval(self) -> bool:
        """Whether the whole interval lies outside the bounds."""
        return self.interval is not None and (self.interval[1] < self.minimum or self.interval[0] > self.maximum)

    @property
    def bounds(self) -> str:
        """The bounds as text."""
        if math.isinf(self.maximum):
            return f"at least {self.minimum:.3g}"
        return (
            f"at most {self.maximum:.3g}" if math.isinf(self.minimum) else f"{self.minimum:.3g} to {self.maximum:.3g}"
        )

    @property
    def deviation(self) -> float:
        """Signed distance of the value to the nearest bound; 0 if it is met or not measured."""
        if self.value is None or self.is_met:
            return 0.0
        return self.value - (self.minimum if self.value < self.minimum else self.maximum)


def model_requirements(
    rows: Mapping[str, MethodMetrics],
    benchmarks: Mapping[str, Sequence[MetricResult]],
    aversions: Mapping[str, Mapping[str, Any]],
    name: str,
) -> list[Requirement]:
    """Margins and ties of one row on each split, and what it has learnt. The same list, in the same order, for every
    row.

    `aversions` has the aversion.json of each row of the stage `evaluate`.
    """
    found = [each for split in SPLIT_TITLES for each in _of_split(rows, split, name)]
    drop, of_truth = (_benchmark_estimate(benchmarks.get(row, ()), ONSET_DROP) for row in (name, "truth"))
    title = "drop of averted gaze after speech onsets / truth"
    found.append(_relative(title, drop, of_truth["value"] if of_truth else None, *ONSET_BOUNDS, kind=TIE))
    predictions = {row: aversions.get(row, {}).get("prediction") for row in (name, *LOOKUPS)}
    found.append(_beyond_lookups("nats a second of true aversions", predictions, name, higher=True))
    for title, key in LEARNT_DISTANCES:
        distances = {row: _benchmark_estimate(benchmarks.get(row, ()), key) for row in (name, *LOOKUPS)}
        found.append(_beyond_lookups(title, distances, name, higher=False))
    return found


def _beyond_lookups(
    title: str, found: Mapping[str, Mapping[str, float] | None], name: str, higher: bool
) -> Requirement:
    """How far the whole interval of a row lies beyond the value of the better lookup."""
    name_of = f"{title}, beyond the better lookup"
    own, lookups = found[name], [each for row in LOOKUPS if (each := found[row])]
    if own is None or len(lookups) < len(LOOKUPS):
        return Requirement(name_of, None, 0.0, kind=LEARNT)
    values = [each["value"] for each in lookups]
    beyond = own["low"] - max(values) if higher else min(values) - own["high"]
    return Requirement(name_of, beyond, 0.0, kind=LEARNT)


def critic_requirements(rows: Mapping[str, MethodMetrics]) -> list[Requirement]:
    """That the critics behind Corr. tell motion from motion under another sound, on each split."""
    found = []
    for split in SPLIT_TITLES:
        for part, title in TIED_PARTS.items():
            difference = metric(rows.get("mismatched", {}), split, part, "corr_minus_fitted")
            found.append(_relative(f"{split}: Corr. of {title}, matched minus mismatched", difference, -1.0, 0.0))
    return found


def face_requirements(rows: Mapping[str, MethodMetrics], name: str) -> list[Requirement]:
    """That the faces of a row show their emotion and close their lips, on each split, as far as fitted motion has these
    figures (a corpus without labels of emotion does not); none if the row has no faces."""
    found = []
    for split, parts in rows.get(name, {}).items():
        for title, key, minimum in FACE if "face" in parts else ():
            own, fitted = (metric(rows.get(each, {}), split, "face", key) for each in (name, "fitted"))
            if fitted is not None:
                found.append(_relative(f"{split}: {title} / fitted motion", own, fitted["value"], minimum))
    return found


def _of_split(rows: Mapping[str, MethodMetrics], split: str, name: str) -> list[Requirement]:
    row, fitted = rows.get(name, {}), rows.get("fitted", {})
    found = [
        _relative(f"{split}: {title}", metric(row, split, part, key), 1.0, low, high)
        for title, part, key, low, high in MARGINS
    ]
    rest, of_fitted = (metric(each, split, "gaze_in_space", "still_fraction") for each in (row, fitted))
    title = f"{split}: gaze at rest / fitted motion"
    found.append(_relative(title, rest, of_fitted["value"] if of_fitted else None, *REST_BOUNDS))
    for part, tied in TIED_PARTS.items():
        tie, whole = (metric(each, split, part, "corr_minus_shuffled") for each in (row, fitted))
        title = f"{split}: tie of {tied} to its sound / fitted motion"
        found.append(_relative(title, tie, whole["value"] if whole else None, MIN_TIE, kind=TIE))
    return found


def _relative(
    name: str,
    found: Mapping[str, float] | None,
    unit: float | None,
    minimum: float,
    maximum: float = math.inf,
    kind: str = MARGIN,
) -> Requirement:
    """A requirement of an estimate in multiples of `unit`."""
    if found is None or not unit:
        return Requirement(name, None, minimum, maximum, kind=kind)
    low, high = sorted((found["low"] / unit, found["high"] / unit))
    return Requirement(name, found["value"] / unit, minimum, maximum, (low, high), kind)


def to_json(found: Mapping[str, Sequence[Requirement]]) -> dict[str, list[dict[str, object]]]:
    """Every requirement of every row, with its interval: {row: [{requirement, bounds, value, interval, ...}]}."""
    return {
        name: [
            {
                "requirement": each.name,
                "kind": each.kind,
                "bounds": each.bounds,
                "value": each.value,
                "interval": each.interval,
                "met": each.is_met,
                "missed_by_interval": each.is_missed_by_interval,
            }
            for each in column
        ]
        for name, column in found.items()
    }


def requirements_table(found: Sequence[Requirement]) -> str:
    """Markdown table of requirements: name, bounds, value, whether it is met."""
    rows = []
    for each in found:
        state = "met" if each.is_met else "not measured" if each.value is None else f"**off by {each.deviation:+.3g}**"
        rows.append([each.name, each.bounds, "" if each.value is None else f"{each.value:.3g}", state])
    return markdown_table(["requirement", "bounds", "value", ""], rows)


def model_requirements_table(found: Mapping[str, Sequence[Requirement]]) -> str:
    """Markdown table of the requirements of all rows; bold: missed. The last lines count those of each kind met."""
    columns = list(found.values())
    headings = ["requirement", "bounds", *(TITLES.get(name, name) for name in found)]
    rows = [[line[0].name, line[0].bounds, *map(_cell, line)] for line in zip(*columns, strict=True)]
    met = [
        [
            f"**{title}, met**",
            f"{len(_of_kind(columns[0], kind))}",
            *(f"{count_met(column, kind)}" for column in columns),
        ]
        for kind, title in KINDS.items()
    ]
    return markdown_table(headings, [*rows, *met])


def count_met(found: Sequence[Requirement], kind: str | None = None) -> int:
    """Number of requirements met: of a kind, or of all (None)."""
    return sum(each.is_met for each in _of_kind(found, kind))


def count_by_kind(found: Sequence[Requirement]) -> dict[str, float]:
    """`requirements_ties` and so on: how many of each kind are met; empty without requirements."""
    return {f"requirements_{title}": float(count_met(found, kind)) for kind, title in KINDS.items()} if found else {}


def met_of(found: Sequence[Requirement], kind: str) -> str:
    """`count_met` of how many, as text; empty if nothing was looked up to compare with."""
    wanted = _of_kind(found, kind)
    if kind == LEARNT and all(each.value is None for each in wanted):
        return ""
    return f"{count_met(wanted)} of {len(wanted)}"


def _of_kind(found: Sequence[Requirement], kind: str | None) -> list[Requirement]:
    return [each for each in found if kind is None or each.kind == kind]


def _cell(requirement: Requirement) -> str:
    if requirement.value is None:
        return ""
    return f"{requirement.value:.2f}" if requirement.is_met else f"**{requirement.value:.2f}**"


def _benchmark_estimate(results: Sequence[MetricResult], name: str) -> Mapping[str, float] | None:
    found = next((each.value for each in results if each.metric.name == name), None)
    return None if found is None else {"value": found.value, "low": found.low, "high": found.high}


SPLIT = "unseen"
COLUMNS = (
    ("Diversity", "gaze", "diversity_ratio"),
    ("eye speed", "gaze", "speed_ratio"),
    ("Corr. eyes", "gaze", "corr"),
    ("L2 eyes", "gaze", "l2"),
    ("Corr. head", "head", "corr"),
)
FACE_METRICS = (
    ("face_mve_mm", "face", "mve"),
    ("face_lve_mm", "face", "lve"),
    ("face_emotion_accuracy", "face", "emotion_accuracy"),
    ("face_bilabials_closed", "face", "bilabials_closed"),
)
FACE_SHARES = {"emotion_accuracy": "emotion recognised", "bilabials_closed": "lips closed at p, b and m"}
INFORMATION, AVERSION = "speech, nats/s", "aversions, nats/s"
MAX_MISSED = 4


def report_summary(
    rows: Mapping[str, MethodMetrics],
    informed: Mapping[str, Mapping[str, Any]],
    aversions: Mapping[str, Mapping[str, Any]],
    required: Mapping[str, Sequence[Requirement]],
    budgets: Mapping[str, str],
    upstream: Sequence[Requirement],
    folder: str,
) -> str:
    """The summary. `upstream`: requirements of the stages before the models; `folder`: where the report is; the others
    as in `summary_table`."""
    missed = [each for each in upstream if not each.is_met]
    return "\n".join(
        [
            *summary_table(rows, informed, aversions, required, budgets),
            "",
            f"fitting, codebooks, critics and the face: {count_met(upstream)} of {len(upstream)} requirements met",
            *(f"  missed: {each.name}: {_value(each)}, required {each.bounds}" for each in missed[:MAX_MISSED]),
            *([f"  and {len(missed) - MAX_MISSED} more"] if len(missed) > MAX_MISSED else []),
            f"All figures with intervals: {folder}/table3.md and face.md. Plots: {folder}/*.png. Runs: make ui",
            "Animate a recording: .venv/bin/talkingeyes animate SPEECH.wav",
            "",
        ]
    )


def summary_table(
    rows: Mapping[str, MethodMetrics],
    informed: Mapping[str, Mapping[str, Any]],
    aversions: Mapping[str, Mapping[str, Any]],
    required: Mapping[str, Sequence[Requirement]],
    budgets: Mapping[str, str],
) -> list[str]:
    """Its lines on models. `informed`: rows of the stage `information`; `aversions`: what each row tells about averted
    gaze; `required`: of each model; `budgets`: the training of each model in words."""
    gaze = {name: row for name, row in rows.items() if metric(row, SPLIT, "gaze", "speed")}
    cells = [["", *([INFORMATION] if informed else []), AVERSION, *(title for title, _, _ in COLUMNS), *KINDS.values()]]
    for name in order_rows(gaze):
        known = information_on_unseen(informed.get(name))
        information = ["" if known is None else f"{known:.2f}"] if informed else []
        predicted = aversions.get(name, {}).get("prediction")
        averted = f"{predicted['value']:.3f}" if predicted else ""
        met = [met_of(required[name], kind) for kind in KINDS]
        cells.append([TITLES.get(name, name), *information, averted, *_figures(rows[name]), *met])
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    table = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in cells]
    return [
        "New speakers (unseen); Diversity and eye speed: ratios to the truth. Of test and unseen: true aversions,",
        "and met of ties (motion follows its sound), margins (it is like motion) and learnt (beyond lookups):",
        "",
        *table,
        *filter(
            None, [training_sentence({TITLES.get(name, name): budgets.get(name, "") for name in order_rows(gaze)})]
        ),
        *_faces(rows),
    ]


def information_on_unseen(row: Mapping[str, Any] | None) -> float | None:
    """Information that speech gives the model about motion, nats per second; None for a row without a likelihood."""
    return None if row is None else float(row[SPLIT]["own"]["total"]["value"])


def row_metrics(
    row: MethodMetrics,
    informed: Mapping[str, Any] | None,
    aversion: Mapping[str, Any] | None,
    required: Sequence[Requirement],
) -> dict[str, float]:
    """The figures of the summary of one row, which `dvc metrics show` prints as a line."""
    known = information_on_unseen(informed)
    first = {} if known is None else {"information": round(known, 4)}
    predicted = (aversion or {}).get("prediction")
    first |= {"aversion_prediction": round(predicted["value"], 4)} if predicted else {}
    named = [*((f"{part}_{name}", part, name) for _, part, name in COLUMNS), *FACE_METRICS]
    found = {title: metric(row, SPLIT, part, name) for title, part, name in named}
    return first | {title: round(each["value"], 4) for title, each in found.items() if each} | count_by_kind(required)


def _figures(row: MethodMetrics) -> list[str]:
    found = [metric(row, SPLIT, part, name) for _, part, name in COLUMNS]
    return [f"{each['value']:.2f}" if each else "" for each in found]


def _faces(rows: Mapping[str, MethodMetrics]) -> list[str]:
    """A line for each face model: mean distances of all vertices and of the lips from the truth, and what the face
    shows as far as the corpus says it."""
    found = []
    for name, row in sorted(rows.items()):
        face = row.get(SPLIT, {}).get("face", {})
        if "mve" in face and name not in TITLES:
            line = f"vertices {face['mve']['value']:.2f} mm from the truth, lips {face['lve']['value']:.1f} mm"
            shares = [f"{title} {face[key]['value']:.2f}" for key, title in FACE_SHARES.items() if key in face]
            found.append(f"{name} (face): {'; '.join([line, *shares])}")
    return found


def _value(requirement: Requirement) -> str:
    return "not measured" if requirement.value is None else f"{requirement.value:.3g}"
