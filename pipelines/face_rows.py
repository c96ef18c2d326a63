"""Rows of ProbTalk3D's Table 1: the measurement of a row with one seed, and its file.

A file (face_rows/ROW-SEED.json) holds the metrics of every sound, so that rows and seeds computed at different times
and on different machines make one page, with differences sound by sound. Used by pipelines.face_table. Not a command.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

from pipelines.evaluate import InputPaths, held_out_sounds
from pipelines.evaluate_face import FaceInputPaths, measure_faces
from pipelines.table_runs import METRICS_FILE, RowResult, read_seed_results
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.evaluation.face.articulation import ArticulationMetrics
from talkingeyes.evaluation.face.summary import FaceMetrics
from talkingeyes.evaluation.face.vertices import VertexErrors
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import Report, Workspace
from talkingeyes.orchestration.stage_graph import StageCall

# Code that a row depends on besides its inputs.
ROW_CODE = (
    "pipelines/evaluate_face.py",
    "pipelines/face_rows.py",
    "src/talkingeyes/evaluation/face",
    "src/talkingeyes/head",
)
FOLDER = "face_rows"
ERRORS, ARTICULATION = (tuple(each.name for each in fields(part)) for part in (VertexErrors, ArticulationMetrics))
COLUMNS = ("split", *ERRORS, *ARTICULATION, "diversity", "diversity_truth", "emotion", "accuracy")
DIGITS = 5  # significant ones


@dataclass(frozen=True)
class FaceRow:
    """A row with one seed.

    `configuration`: hash of its settings; `scores`: energy score on val by step of stage 2; `by_temperature`: the same
    of the weights that were kept, by temperature or noise; `sounds`: metrics by split.
    """

    row: str
    seed: int
    configuration: str
    revision: str
    scores: Mapping[str, float]
    by_temperature: Mapping[str, float]
    sounds: Mapping[str, list[FaceMetrics]]


def measure(call: StageCall, workspace: Workspace) -> Report:
    """Metrics of a row, sound by sound."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    places = (workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", row))
    sounds = [
        item.takes for item in held_out_sounds(InputPaths("fitted", *places, settings.benchmark_samples), settings)
    ]
    paths = FaceInputPaths(row, workspace.corpus, data("fit"), data("sample", row), settings.seed)
    figures = measure_faces(paths, sounds, workspace.jobs)
    found = [{"split": takes[0].split, **asdict(one)} for takes, one in zip(sounds, figures, strict=True)]
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps(found))
    return Report()


def measured_row(found: RowResult, seed: int, configuration: str) -> FaceRow:
    """A row of the result store."""
    sounds: dict[str, list[FaceMetrics]] = {}
    for each in json.loads(found.figures.read_text()):
        errors = VertexErrors(**each["errors"]) if each["errors"] else None
        rest = {name: each[name] for name in ("diversity", "diversity_truth", "emotion", "accuracy")}
        metrics = FaceMetrics(errors=errors, articulation=ArticulationMetrics(**each["articulation"]), **rest)
        sounds.setdefault(each["split"], []).append(metrics)
    history = json.loads((found.model / "history.json").read_text()) if found.model else []
    scores = {f"{each['step']:.0f}": -each["validation_score"] for each in history if "step" in each}
    chosen = [each for each in history if "step" not in each]
    by_temperature = {key.partition("/")[2]: score for each in chosen for key, score in each.items()}
    return FaceRow(found.name, seed, configuration, revision(), scores, by_temperature, sounds)


def write_row(folder: Path, row: FaceRow) -> None:
    """Write the file of a row."""
    records = [_record(split, each) for split, sounds in row.sounds.items() for each in sounds]
    content = {field.name: getattr(row, field.name) for field in fields(row) if field.name != "sounds"}
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / f"{row.row}-{row.seed}.json") as temporary:
        temporary.write_text(
            json.dumps(content | {"columns": COLUMNS, "sounds": records}, separators=(",", ":")) + "\n"
        )


def read_rows(folder: Path, configurations: Mapping[str, str] | None = None) -> dict[str, list[FaceRow]]:
    """The rows of all files in a folder, by name, then by seed. Raises InputError as `read_seed_results`."""
    return read_seed_results(folder, "pipelines.face_table", _row, configurations)


def _record(split: str, metrics: FaceMetrics) -> list[Any]:
    errors = astuple(metrics.errors) if metrics.errors else [None] * len(ERRORS)
    rest = (metrics.diversity, metrics.diversity_truth, metrics.emotion, metrics.accuracy)
    values = (split, *errors, *astuple(metrics.articulation), *rest)
    return [float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for value in values]


def _row(content: Mapping[str, Any]) -> tuple[str, FaceRow]:
    sounds: dict[str, list[FaceMetrics]] = {}
    for split, metrics in map(_metrics, content["sounds"]):
        sounds.setdefault(split, []).append(metrics)
    given = {field.name: content[field.name] for field in fields(FaceRow) if field.name != "sounds"}
    return content["row"], FaceRow(**given, sounds=sounds)


def _metrics(record: Iterable[Any]) -> tuple[str, FaceMetrics]:
    values = dict(zip(COLUMNS, record, strict=True))
    errors = VertexErrors(**{name: values[name] for name in ERRORS}) if values["frames"] is not None else None
    articulation = ArticulationMetrics(**{name: values[name] for name in ARTICULATION})
    rest = {name: values[name] for name in ("diversity", "diversity_truth", "emotion", "accuracy")}
    return str(values["split"]), FaceMetrics(errors=errors, articulation=articulation, **rest)
