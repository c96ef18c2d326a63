"""All rows of the comparison with recorded people: distances and two-sample tests by state, and their tables.

Rows are groups of speakers: baselines first, then the motions. JSON is what the tables are made of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.bootstrap import BootstrapSettings, Estimate
from talkingeyes.evaluation.people.fixations import Person
from talkingeyes.evaluation.people.measures import (
    MEASURES,
    MIN_SPEAKERS,
    MIN_TIME_S,
    measure_distance,
    measure_floor,
    people_values,
    pool_speakers,
)
from talkingeyes.evaluation.people.two_sample import each_its_own, reference_auc, sequences_of, two_sample_auc
from talkingeyes.evaluation.text_tables import aligned
from talkingeyes.physiology.gaze_population import STATES

SCHEMA = "talkingeyes.people/1"
# Targets: mean ratio by state, largest ratio, AUC.
MEAN_TARGETS = {"speaking": 0.5, "listening": 1.0}
LARGEST_TARGET, AUC_TARGET = 1.5, 0.65
REACHED = {True: "yes", False: "no"}

Content = Mapping[str, Any]


def compare_with_people(
    people: Sequence[Person], rows: Mapping[str, Sequence[Person]], settings: BootstrapSettings
) -> dict[str, Any]:
    """The comparison of all rows, as JSON: for each state the people's values, and distances and AUC of each row."""
    return {
        "schema": SCHEMA,
        "people": [person.name for person in people],
        "targets": {"mean_ratio": MEAN_TARGETS, "largest_ratio": LARGEST_TARGET, "auc": AUC_TARGET},
        "states": {state: _state(people, rows, state, settings) for state in STATES},
    }


def _state(
    people: Sequence[Person], rows: Mapping[str, Sequence[Person]], state: str, settings: BootstrapSettings
) -> dict[str, Any]:
    values = people_values(people, state)
    columns = (values.medians, values.ranges, values.between_people, measure_floor(values, settings.seed))
    recorded = {
        measure.name: {
            "title": measure.title,
            "unit": measure.unit,
            "median": _number(median),
            "low": _number(low),
            "high": _number(high),
            "between_people": _number(between),
            "floor": _number(floor),
        }
        for measure, median, (low, high), between, floor in zip(MEASURES, *columns, strict=True)
    }
    sequences = sequences_of(people, state)
    auc, reason = _attempt(lambda: reference_auc(sequences, settings))
    floors = columns[3][np.isfinite(columns[3])]
    return {
        "people": {
            "seconds": sum(float(person.records[state].time_s.sum()) for person in people),
            "mean_floor": float(floors.mean()) if len(floors) else None,
            "auc": auc,
            "reason": reason,
            "measures": recorded,
        },
        "rows": {name: _row(people, speakers, state, settings) for name, speakers in rows.items()},
    }


def _row(
    people: Sequence[Person], speakers: Sequence[Person], state: str, settings: BootstrapSettings
) -> dict[str, Any]:
    found = measure_distance(people_values(people, state), speakers, state, settings)
    enough = sum(speaker.records[state].time_s.sum() >= MIN_TIME_S for speaker in speakers) >= MIN_SPEAKERS
    ours = sequences_of(speakers if enough else [pool_speakers(speakers)], state)
    auc, reason = _attempt(
        lambda: two_sample_auc(sequences_of(people, state), ours if enough else each_its_own(ours), settings)
    )
    known = bool(found.distances)
    return {
        "speakers": len(speakers),
        "seconds": sum(float(speaker.records[state].time_s.sum()) for speaker in speakers),
        "mean_ratio": asdict(found.mean_ratio) if known else None,
        "largest": dict(zip(("measure", "ratio"), found.largest, strict=True)) if known else None,
        "auc": auc,
        "reason": reason,
        "measures": {name: asdict(each) for name, each in found.distances.items()},
    }


def _attempt(compute: Any) -> tuple[dict[str, float] | None, str]:
    try:
        found: Estimate = compute()
    except InputError as error:
        return None, str(error)
    return asdict(found), ""


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def state_table(content: Content, state: str) -> list[list[str]]:
    """The table of one state, with its heading: people, then all rows with value and ratio; then the summary."""
    found = content["states"][state]
    people, rows = found["people"], found["rows"]
    table = [["measure", "people (range)", "apart", "halves", *rows]]
    for name, each in people["measures"].items():
        unit = "" if each["unit"] == "fraction" else f", {each['unit']}"
        recorded = "-" if each["median"] is None else f"{each['median']:.2f} ({each['low']:.2f} to {each['high']:.2f})"
        cells = [_measured(row["measures"].get(name)) for row in rows.values()]
        table.append([each["title"] + unit, recorded, _short(each["between_people"]), _short(each["floor"]), *cells])
    mean_target = content["targets"]["mean_ratio"][state]
    largest_target, auc_target = content["targets"]["largest_ratio"], content["targets"]["auc"]
    table += [
        [f"mean ratio (at most {mean_target:g})", "", "", _short(people["mean_floor"])]
        + [_interval(row["mean_ratio"], mean_target) for row in rows.values()],
        [f"largest ratio (at most {largest_target:g})", "", "", ""]
        + [_largest(row["largest"], largest_target) for row in rows.values()],
        [f"two-sample AUC (at most {auc_target:g})", _interval(people["auc"]), "", ""]
        + [_interval(row["auc"], auc_target) for row in rows.values()],
        ["seconds observed", f"{people['seconds']:.0f}", "", "", *(f"{row['seconds']:.0f}" for row in rows.values())],
    ]
    return table


def _measured(found: Content | None) -> str:
    if found is None:
        return "-"
    return f"{found['value']:.2f} [{found['ratio']['value']:.2f}]{'*' if found['pooled'] else ''}"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _interval(found: Content | None, target: float | None = None) -> str:
    if found is None:
        return "-"
    mark = "" if target is None else f" {REACHED[found['value'] <= target]}"
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f}){mark}"


def _largest(found: Content | None, target: float) -> str:
    if found is None:
        return "-"
    return f"{found['ratio']:.2f} {REACHED[found['ratio'] <= target]} ({found['measure']})"


def as_text(content: Content) -> str:
    """The tables for a terminal."""
    parts = []
    for state in content["states"]:
        parts.append(f"while {state}\n{aligned(state_table(content, state))}")
    return "\n\n".join(parts)
