"""The report in at most 25 lines of plain text: six figures per model, requirements, and where the rest is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from talkingeyes.evaluation.paper_metrics.requirements import Requirement, count_met, met_of
from talkingeyes.evaluation.paper_metrics.table3 import TITLES, MethodMetrics, metric, order_rows
from talkingeyes.evaluation.text_tables import training_sentence

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
INFORMATION, AVERSION = "speech, nats/s", "aversion, nats/s"
TIES, MARGINS = "ties met", "margins met"
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
    """Its lines on models. `informed`: rows of the stage `information`; `aversions`: what speech tells about averted
    gaze, of each row; `required`: of each model; `budgets`: the training of each model in words."""
    gaze = {name: row for name, row in rows.items() if metric(row, SPLIT, "gaze", "speed")}
    cells = [["", *([INFORMATION] if informed else []), AVERSION, *(title for title, _, _ in COLUMNS), TIES, MARGINS]]
    for name in order_rows(gaze):
        known = information_on_unseen(informed.get(name))
        information = ["" if known is None else f"{known:.2f}"] if informed else []
        averted = f"{aversions[name]['information']['value']:.3f}" if name in aversions else ""
        met = [met_of(required[name], ties) for ties in (True, False)]
        cells.append([TITLES.get(name, name), *information, averted, *_figures(rows[name]), *met])
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    table = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in cells]
    return [
        "New speakers (unseen); Diversity and eye speed: ratios to the truth. Of test and unseen:",
        "aversion, ties (motion follows its sound) and margins (it is like motion, whatever the sound):",
        "",
        *table,
        training_sentence({TITLES.get(name, name): budgets.get(name, "") for name in order_rows(gaze)}),
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
    first |= {} if aversion is None else {"aversion_information": round(aversion["information"]["value"], 4)}
    named = [*((f"{part}_{name}", part, name) for _, part, name in COLUMNS), *FACE_METRICS]
    found = {title: metric(row, SPLIT, part, name) for title, part, name in named}
    met = {
        "requirements_ties": float(count_met(required, True)),
        "requirements_margins": float(count_met(required, False)),
    }
    return first | {title: round(each["value"], 4) for title, each in found.items() if each} | (met if required else {})


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
