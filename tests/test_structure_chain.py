"""The whole chain on the tiny corpus, from text to table, as in `make tiny`."""

import json
import subprocess
import sys

import pytest
from model_conf import compose

from pipelines.experiment import pipeline_calls


def run_tiny(repository, root, *overrides):
    """Run the chain in a separate folder."""
    command = [sys.executable, "-m", "pipelines.experiment", "experiment=tiny", f"workspace={root}", *overrides]
    result = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False, timeout=550)
    assert result.returncode == 0, result.stderr[-4000:]


def test_the_tiny_chain_runs_from_text_to_table(tiny):
    for call in pipeline_calls(compose(["experiment=tiny"])):
        assert any((tiny / call.folder).iterdir()), f"{call.address} wrote nothing"
    assert not list((tiny / "data").rglob(".*.partial"))
    assert not list((tiny / "data").rglob(".*.resume"))
    assert json.loads((tiny / "data/report/metrics.json").read_text())
    assert (tiny / "data/report/table3.md").read_text()


@pytest.mark.slow
def test_chain_is_reproducible_for_any_number_of_jobs(repository, tmp_path):
    contents = []
    for jobs in (1, 2, 4):
        store = tmp_path / f"store-{jobs}"
        run_tiny(repository, tmp_path / str(jobs), f"machine.jobs={jobs}", f"result_store={store}")
        contents.append(
            {path.relative_to(store): path.read_bytes() for path in store.glob("*/output/**/*") if path.is_file()}
        )
    assert len(contents[0]) > 500
    assert contents[0] == contents[1] == contents[2]
