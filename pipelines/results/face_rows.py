"""Rows of ProbTalk3D's Table 1: the measurement of a row with one seed, and its file.

A file (face_rows/ROW-SEED.json) holds the metrics of every sound, so that rows and seeds computed at different times
and on different machines make one page, with differences sound by sound. Used by pipelines.results.face_table. Not a
command.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

from pipelines.evaluate import held_out_sounds
from pipelines.evaluate_face import measure_faces
from pipelines.results.table_runs import METRICS_FILE, RowResult, read_seed_results
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.evaluation.papers.probtalk3d_articulation import ArticulationMetrics
from talkingeyes.evaluation.papers.probtalk3d_metrics import FaceMetrics
from talkingeyes.evaluation.papers.probtalk3d_vertices import VertexErrors
from talkingeyes.evaluation.papers.talkingeyes_metrics import EvaluateSettings
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import Report, Workspace
from talkingeyes.orchestration.stage_graph import StageCall

# Code that a row depends on besides its inputs.
ROW_CODE = (
    "pipelines/evaluate_face.py",
    "pipelines/results/face_rows.py",
    "src/talkingeyes/evaluation/papers",
    "src/talkingeyes/head",
)
FOLDER = "face_rows"
ERRORS, ARTICULATION = (tuple(each.name for each in fields(part)) for part in (VertexErrors, ArticulationMetrics))
REST = ("diversity", "diversity_truth", "emotion", "accuracy")
COLUMNS = ("split", *ERRORS, *ARTICULATION, *REST)
DIGITS = 5  # significant ones


@dataclass(frozen=True)
class FaceRow:
    """A row with one seed.

    `configuration`: hash of its settings; `scores`: energy score on val by step of stage 2; `temperature`: that of
    sampling (of the VAE: the noise), None without a network; `sounds`: metrics by split.
    """

    row: str
    seed: int
    configuration: str
    revision: str
    scores: Mapping[str, float]
    temperature: float | None
    sounds: Mapping[str, list[FaceMetrics]]


def measure(call: StageCall, workspace: Workspace) -> Report:
    """Metrics of a row, sound by sound."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,) = call.names
    sounds = [item.takes for item in held_out_sounds(workspace.input_paths("fitted"), settings)]
    figures = measure_faces(workspace.input_paths(row), sounds, workspace.jobs, settings.seed)
    records = [_record(takes[0].split, one) for takes, one in zip(sounds, figures, strict=True)]
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps({"columns": COLUMNS, "sounds": records}))
    return Report()


def measured_row(found: RowResult, seed: int, configuration: str) -> FaceRow:
    """A row of the result store."""
    history, settings = [], {}
    if found.model:
        history = json.loads((found.model / "history.json").read_text())
        settings = json.loads((found.model / "config.json").read_text())["model"]
    scores = {f"{each['step']:.0f}": -each["validation_score"] for each in history}
    return FaceRow(
        found.name,
        seed,
        configuration,
        revision(),
        scores,
        settings.get("temperature"),
        _sounds(json.loads(found.figures.read_text())),
    )


def write_row(folder: Path, row: FaceRow) -> None:
    """Write the file of a row."""
    records = [_rounded(_record(split, each)) for split, sounds in row.sounds.items() for each in sounds]
    content = {field.name: getattr(row, field.name) for field in fields(row) if field.name != "sounds"}
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / f"{row.row}-{row.seed}.json") as temporary:
        temporary.write_text(
            json.dumps(content | {"columns": COLUMNS, "sounds": records}, separators=(",", ":")) + "\n"
        )


def read_rows(folder: Path, configurations: Mapping[str, str] | None = None) -> dict[str, list[FaceRow]]:
    """The rows of all files in a folder, by name, then by seed. Raises InputError as `read_seed_results`."""
    return read_seed_results(folder, "pipelines.results.face_table", _row, configurations)


def _row(content: Mapping[str, Any]) -> tuple[str, FaceRow]:
    given = {field.name: content[field.name] for field in fields(FaceRow) if field.name != "sounds"}
    return content["row"], FaceRow(**given, sounds=_sounds(content))


def _record(split: str, metrics: FaceMetrics) -> list[Any]:
    errors = astuple(metrics.errors) if metrics.errors else [None] * len(ERRORS)
    return [split, *errors, *astuple(metrics.articulation), *(getattr(metrics, name) for name in REST)]


def _rounded(record: list[Any]) -> list[Any]:
    return [float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for value in record]


def _sounds(content: Mapping[str, Any]) -> dict[str, list[FaceMetrics]]:
    """Metrics by split of the records of all sounds."""
    found: dict[str, list[FaceMetrics]] = {}
    for record in content["sounds"]:
        values = dict(zip(content["columns"], record, strict=True))
        errors, articulation, rest = ({name: values[name] for name in each} for each in (ERRORS, ARTICULATION, REST))
        metrics = FaceMetrics(
            errors=None if errors["frames"] is None else VertexErrors(**errors),
            articulation=ArticulationMetrics(**articulation),
            **rest,
        )
        found.setdefault(values["split"], []).append(metrics)
    return found
