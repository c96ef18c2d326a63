"""A run whose process was killed while it was logged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from talkingeyes.orchestration import mlflow_logging
from talkingeyes.orchestration.run import MethodResult, Report


@pytest.mark.long
def test_a_killed_run_is_marked_and_logged_again(tmp_path: Path, monkeypatch: Any) -> None:
    report = Report(metrics={}, rows=[MethodResult("truth", {"a": 1.0})])

    def log() -> None:
        mlflow_logging.log_run(tmp_path, "report", "report", {"study": "default"}, set(), 1.0, report)

    log()
    client = mlflow_logging._client(tmp_path)
    experiment = client.get_experiment_by_name("experiments").experiment_id
    (first,) = client.search_runs([experiment])
    client.update_run(first.info.run_id, "RUNNING")  # as if the process had been killed before the end
    log()
    status = {run.info.run_id: run.info.status for run in client.search_runs([experiment])}
    assert status.pop(first.info.run_id) == "KILLED"
    assert list(status.values()) == ["FINISHED"]
    log()  # what was logged completely is not repeated
    assert len(client.search_runs([experiment])) == 2
