"""A saved view for the comparison page of MLflow's UI, so that runs can be compared without choosing columns first.

By default, the page lists runs without metrics. MLflow stores a view that a user saves under `Views` as a tag of the
experiment. This module writes another such tag. It does not change views that a user has saved.

Run: python -m talkingeyes.orchestration.mlflow_view build/tiny 127.0.0.1:5000

Reads mlflow.db in that folder; prints the URLs of the comparison on a server at that address. `make ui` does both.
"""

from __future__ import annotations

import json
import sqlite3
import sys
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from talkingeyes.core.errors import InputError

# Columns of the table, and axes of the charts; a run without one of them is not drawn there. Motion must be like motion
# (diversity, speed; ratios to the truth) and follow its sound (the tie: Corr. less that under other sounds of the
# speaker, as a ratio to fitted motion).
# A column shows twelve letters, so these are logged a second time under names of that length, to three decimals.
TEST_METRICS = {
    "ties": "requirements_ties",
    "margins": "requirements_margins",
    "learnt": "requirements_learnt",
    "div. eyes": "test/gaze/diversity_ratio",
    "speed eyes": "test/gaze/speed_ratio",
    "corr. eyes": "test/gaze/corr",
    "tie eyes": "test/gaze/tie_ratio",
    "still gaze": "test/gaze_in_space/still_fraction",
    "div. head": "test/head/diversity_ratio",
    "speed head": "test/head/speed_ratio",
    "corr. head": "test/head/corr",
    "tie head": "test/head/tie_ratio",
}
# Metrics by which models, settings and sweeps are chosen; runs of sweeps may have no results on test.
VAL_METRICS = ("val/eye_speed_ratio", "val/corr", "val/tie", "val/corr_head", "val/tie_head", "val/dynamics_distance")
TAGS = ("experiment", "seed", "split", "corpus", "revision")
# The table opens sorted by the ties to speech that a row meets, the most first.
ORDER_BY = "metrics.`ties`"

NAME = "Comparison"
TAG = "mlflow.sharedViewState.comparison"
# URL path of the view on the server; {experiment} is the id of the experiment.
PAGE = (
    "/#/experiments/{experiment}/runs?workflowType=machine_learning&compareRunsMode={mode}&viewStateShareKey=comparison"
)


def shown_metrics(metrics: Mapping[str, float]) -> dict[str, float]:
    """Those of a row that the table shows, by their short names."""
    return {short: round(metrics[name], 3) for short, name in TEST_METRICS.items() if name in metrics}


def page(experiment: str, mode: str = "TABLE") -> str:
    """URL path of the view, with mode TABLE or CHART."""
    return PAGE.format(experiment=experiment, mode=mode)


def saved_view() -> str:
    """Value of the tag: MLflow's format of a saved view."""
    section = {"uuid": "comparison", "name": NAME, "display": True, "isReordered": False, "deleted": False}
    state = {
        "selectedColumns": [*(f"tags.`{tag}`" for tag in TAGS), *map(_column, (*TEST_METRICS, *VAL_METRICS))],
        "compareRunCharts": [_lines("test", TEST_METRICS), _lines("val", VAL_METRICS), _differences()],
        "compareRunSections": [{**section, "isGenerated": False, "columns": 1, "cardHeight": 360}],
        "hideEmptyCharts": True,
        "orderByKey": ORDER_BY,
        "orderByAsc": False,
    }
    return json.dumps({"name": NAME, "createdAt": 0, "updatedAt": 0, "state": json.dumps(state)})


def _column(metric: str) -> str:
    return f"metrics.`{metric}`"


def _lines(name: str, metrics: Iterable[str]) -> dict[str, Any]:
    """A parallel coordinates chart, one line per run."""
    chosen = {"selectedParams": [], "selectedMetrics": list(metrics), "showAllRuns": False}
    return {**_chart(name, "PARALLEL"), **chosen}


def _differences() -> dict[str, Any]:
    """A table of the parameters that differ between the runs, and of all metrics."""
    shown = {"showChangeFromBaseline": False, "showDifferencesOnly": True, "baselineColumnUuid": ""}
    groups = ["Parameters", "Model metrics"]
    return {**_chart("differences", "DIFFERENCE"), "chartName": "Differences", "compareGroups": groups, **shown}


def _chart(name: str, kind: str) -> dict[str, Any]:
    place = {"metricSectionId": "comparison", "runsCountToCompare": 10}
    return {"uuid": name, "type": kind, "deleted": False, "isGenerated": False, **place}


def experiment_id(root: Path) -> str:
    """The id of the experiment that holds the rows. Raises InputError if there are none yet."""
    path = root / "mlflow.db"
    query = "select experiment_id from experiments where name = 'experiments'"
    found = None
    if path.exists():
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as store:
            found = store.execute(query).fetchone()
    if found is None:
        raise InputError(f"{path}: should hold rows to compare, which `make repro` or `make tiny` log; got none")
    return str(found[0])


def main(arguments: list[str]) -> int:
    """Print the URLs and return the exit status."""
    root, server = arguments
    try:
        experiment = experiment_id(Path(root))
    except InputError as error:
        print("error:", error, file=sys.stderr)
        return 2
    print(
        f"One table: http://{server}{page(experiment, 'TABLE')}\nOne chart: http://{server}{page(experiment, 'CHART')}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
