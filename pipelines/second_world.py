"""Train all models on a second synthetic world, and compare the rank order of models with that of the default chain.

Run     python -m pipelines.second_world [overrides]       (after make report)
Reads   conf/experiment/second_world.yaml; benchmarks of the default chain in data/evaluate
Writes  docs/second_world.md and .json; works in the folder that `workspace` names (build/second_world)

An interrupted run resumes (the result store of pipelines/experiment.py). Nothing may be chosen by these figures.
Outside the default pipeline.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from pipelines.experiment import run_pipeline
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.benchmark.page import FAMILIES
from talkingeyes.evaluation.benchmark.rank_agreement import RankAgreement, Results, rank_agreements, total_agreement
from talkingeyes.evaluation.benchmark.table import from_json
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Workspace, run_command

DOCS = Path("docs")
BASELINES = ("mean", "random", "similar", "untrained")
PAGE = """# A second world

Written by `python -m pipelines.second_world` ([log](log/2026-11-26-second-world.md)). All models are trained anew on a
second synthetic corpus, whose laws and timings of gaze are at the edges of the literature, with other voices and
languages (conf/experiment/second_world.yaml). Every metric of the [benchmark](benchmark.md) ranks them in both worlds.
Nothing was chosen by these figures.

Models are ordered by their error, the distance to the truth of their world. Tau is Kendall's, between the two orders: 1
is the same order, -1 the reverse; random orders have a mean of 0 and a standard deviation of {spread_all:.2f} for all
models, {spread_trained:.2f} for the trained ones. A pair of models is apart if the 95 % intervals of their errors do
not overlap. "All" has the baselines ({baselines}), which are easy to tell from the others.
[second_world.json](second_world.json) has every metric.

"""
COLUMNS = (
    "metrics",
    *(f"{column}, {title}" for title in ("all", "trained") for column in ("median tau", "pairs in the same order")),
)
Agreements = Mapping[str, Sequence[RankAgreement]]


def main() -> None:
    """Run the chain on the second world, compare, and write the page."""
    params = compose(["experiment=second_world", "target=evaluate", *sys.argv[1:]])
    models = list(params["model"])
    chain = read_benchmarks(Workspace.open(Path.cwd()).data("evaluate"), models)
    workspace = Path(params["workspace"])
    run_pipeline(params, workspace)
    world = read_benchmarks(workspace / "data/evaluate", models)
    trained = {name: rows for name, rows in chain.items() if name not in BASELINES}
    found = {"all": rank_agreements(chain, world), "trained": rank_agreements(trained, world)}
    numbers = {name: [asdict(each) for each in rows] for name, rows in found.items()}
    for path, text in (("second_world.json", json.dumps(numbers, indent=1) + "\n"), ("second_world.md", page(found))):
        with atomic_write(DOCS / path) as temporary:
            temporary.write_text(text)
    print(page(found))


def read_benchmarks(folder: Path, models: Sequence[str]) -> Results:
    """The benchmarks of models. Raises InputError if one is missing."""
    found = {}
    for name in models:
        path = folder / name / "benchmark.json"
        if not path.is_file():
            raise InputError(f"{folder}: should hold the benchmark of {name}, got none; `make report` makes it")
        found[name] = from_json(json.loads(path.read_text()))
    return found


def page(found: Agreements) -> str:
    """The page: one row for each family of metrics, and one for all of them."""
    spreads = {f"spread_{name}": random_spread(max(each.models for each in rows)) for name, rows in found.items()}
    families = [key for key in FAMILIES if any(_of(key, rows) for rows in found.values())]
    lines = [[FAMILIES[key], *_cells({name: _of(key, rows) for name, rows in found.items()})] for key in families]
    lines.append(["**All metrics**", *_cells(found)])
    return PAGE.format(baselines=", ".join(BASELINES), **spreads) + markdown_table(["", *COLUMNS], lines) + "\n"


def _of(family: str, rows: Sequence[RankAgreement]) -> list[RankAgreement]:
    return [each for each in rows if each.metric.split("/")[0] == family]


def _cells(found: Agreements) -> list[str]:
    cells = [str(max(map(len, found.values())))]
    for rows in found.values():
        median, apart, agreeing = total_agreement(rows)
        cells += [f"{median:.2f}", f"{agreeing} of {apart}"]
    return cells


def random_spread(models: int) -> float:
    """Standard deviation of tau between two independent random orders (Kendall 1938)."""
    return float((2 * (2 * models + 5) / (9 * models * (models - 1))) ** 0.5)


if __name__ == "__main__":
    run_command(main)
