"""The summary of some rows of the chain: what `make repro` prints. The stage `report` has all rows, with intervals.

Run     python -m pipelines.summary [--log] ROW ...
Reads   what `report` reads of these rows, without data/information and data/validate, which may be of other models
Writes  the summary to stdout, build/table3.md; with --log, the rows to MLflow
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from pipelines.report import INTRODUCTION, Results, flat_metrics
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.papers.table3 import order_rows
from talkingeyes.evaluation.report.requirements import summary_table
from talkingeyes.orchestration.run import MethodResult, Report, Workspace, run_command, run_stage

LOG = "--log"
PAGE = "build/table3.md"
MORE = f"""
Table III with intervals: {PAGE}. Plots, films, the other models and the face: make report, 45 minutes more
Runs: make ui
Animate a recording: .venv/bin/talkingeyes animate SPEECH.wav"""


def run(names: Sequence[str], workspace: Workspace) -> Report:
    """Print the summary. Raises InputError for a row that was not evaluated."""
    results = replace(Results.read(workspace, names), informed={}, on_val={})
    if missing := [name for name in names if not workspace.data("evaluate", name).is_dir()]:
        raise InputError(f"{workspace.data('evaluate', missing[0])}: should be a row of `evaluate`, got no folder")
    print("\n".join(summary_table(results.rows, {}, results.aversions, results.required, results.budgets)))
    page = workspace.root / PAGE
    page.parent.mkdir(exist_ok=True)
    page.write_text("\n".join([INTRODUCTION, *results.table3()]))
    return Report(rows=[MethodResult(name, flat_metrics(name, results)) for name in order_rows(results.rows)])


def main() -> None:
    """The summary of the rows named on the command line, in the current folder."""
    names = [each for each in sys.argv[1:] if each != LOG]
    if not names:
        raise InputError("summary: should get rows of `evaluate`, got none")
    workspace, summarise = Workspace.open(Path.cwd()), partial(run, names)
    if LOG in sys.argv:
        run_stage("summary", summarise, workspace)
    else:
        summarise(workspace)
    print(MORE)


if __name__ == "__main__":
    run_command(main)
