"""The paper's tables with three seeds: TalkingEyes Tables III, V (with II as ranges), VI and VII.

Run     python -m pipelines.tables [tables=table3,table7] [seeds=0,1,2] [--out DIR] [overrides]
Reads   conf/experiment/table3, table5, table6, table7; corpus, fit and embedding of `make repro` are reused if they
        match
Writes  DIR (by default docs/): tables.md, tables.json; works in the folder that `workspace` names (build/tables)

A row is computed once, even if it is in several tables. Seeds are those of training and sampling; corpus, fit,
codebooks and critic are shared. An interrupted run resumes (pipelines/table_runs.py). Outside the default pipeline.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

from pipelines.evaluate import SPLITS
from pipelines.paper_table_rows import LONG_MOTIONS, LONG_S, READS, ROW_CODE, measure_row
from pipelines.table_runs import RowResult, RowSpec, TableOptions, compute_rows, configs_by_seed, parse_arguments
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.multi_seed import MultiSeedEstimate, MultiSeedStatistic
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.evaluation.paper_metrics.table3 import markdown_row
from talkingeyes.evaluation.tables.definitions import HEAD_AND_EYE_COLUMNS, REFERENCES, TABLES, TITLES, PaperTable
from talkingeyes.evaluation.tables.page import TableResult, as_json, markdown, table_result
from talkingeyes.evaluation.tables.row_metrics import row_metrics
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import run_command

INTRODUCTION = """# The paper's tables

Written by `python -m pipelines.tables{words}` (`make tables`) at revision {revision}; an interrupted run resumes. The
question of each table and the paper's values are in conf/experiment/table3, table5, table6, table7. This page shows
new speakers (split `unseen`), means over the seeds {seeds}. [tables.json](tables.json) has both splits and all metrics,
with {level:.0%} intervals over clips and the range of the seeds.

The paper's order is not reproduced in the columns of the eyes, because the paper's eyes stand still here after 400
training steps. Why, and what longer training changes: [log](log.md), "why the paper's order is not ours" and "the
experiments that were left".

In brackets is the paper's value, of another corpus, encoder and critic, and of about 480,000 training steps: compare
the order of rows, not the values. Diversity, Corr. and L2 (radians) compare with fitted motion, speeds and ranges with
the true motion. A constant pose has the lowest L2, so read whole rows. Table II of the paper is a description; here it
is the middle 95 % of each rotation over that of the truth. Motion above 5 Hz is measured on {count} motions of
{long_s:.0f} s per split. `TalkingEyes, events` is conditioned on the speaker; for unseen speakers, a random training
speaker is used for each sound. All other models are unconditional.

"""
# Metrics that are shown besides the columns of the paper.
SHOWN = {
    "gaze/speed",
    "gaze/still_fraction",
    "head/range_ratio",
    "gaze/range_ratio",
    "head/speed_above_5hz",
    "gaze/speed_above_5hz",
}
SHOWN_SPLIT = "unseen"
ORDERS = """## The paper's order of rows

Kendall's tau over all pairs of rows with different values in the paper: agreeing minus reversed pairs, divided by all
pairs. +1 is the paper's order. Pairs with their differences and significance: `orders` in
[tables.json](tables.json).
"""


def main() -> None:
    """Compute all rows of the chosen tables with all seeds, then write the page."""
    wanted = options(sys.argv[1:])
    names, made = wanted.words["tables"], configs_by_seed(wanted.overrides, wanted.seeds)
    settings = EvaluateSettings.model_validate(made[0]["evaluate"])
    models = tuple(dict.fromkeys(row for name in names for row in TABLES[name].rows))
    kind = RowSpec("table_metrics", ROW_CODE, READS, ("evaluate",), measure_row, models, REFERENCES)
    figures = _figures(compute_rows(made, kind, critic=True, title="tables").by_name)
    tables = {name: _tables(name, figures, settings) for name in names}
    words = "".join(f" {text}" for text in sys.argv[1:])
    introduction = INTRODUCTION.format(
        words=words,
        revision=revision(),
        seeds=", ".join(map(str, wanted.seeds)),
        level=settings.bootstrap.confidence_level,
        count=LONG_MOTIONS,
        long_s=LONG_S,
    )
    plain = {"seeds": wanted.seeds, "tables": {name: as_json(TABLES[name], each) for name, each in tables.items()}}
    wanted.out.mkdir(parents=True, exist_ok=True)
    (wanted.out / "tables.json").write_text(json.dumps(plain, indent=1))
    (wanted.out / "tables.md").write_text(introduction + page(tables))
    print("\n".join(markdown(TABLES[name], by_split) for name, by_split in tables.items()))


def page(tables: Mapping[str, Mapping[str, TableResult]]) -> str:
    """The page below its introduction: the tables of new speakers, and the order of rows in all splits."""
    shown = {name: by_split[SHOWN_SPLIT] for name, by_split in tables.items() if SHOWN_SPLIT in by_split}
    parts = [_table(TABLES[name], result) for name, result in shown.items()]
    return "\n".join([*parts, _orders(tables)])


def _table(table: PaperTable, result: TableResult) -> str:
    columns = [*table.paper_columns, *(each for each in table.extra_columns if each.metric in SHOWN)]
    lines = [["", *(each.heading for each in columns)], ["---"] * (len(columns) + 1)]
    for name, cells in result.cells.items():
        papers = table.rows.get(name) or ()
        written = [_cell(cells.get(each.metric), papers[at : at + 1], each.digits) for at, each in enumerate(columns)]
        lines.append([TITLES[name], *written])
    return "\n".join([f"## {table.title}", "", table.question, "", *map(markdown_row, lines), ""])


def _cell(estimate: MultiSeedEstimate | None, paper: Sequence[float], digits: int) -> str:
    return "" if estimate is None else f"{estimate.value:.{digits}f}" + "".join(f" ({each:.3f})" for each in paper)


def _orders(tables: Mapping[str, Mapping[str, TableResult]]) -> str:
    """Kendall's tau by table, split and column."""
    lines = [["", *(each.heading for each in HEAD_AND_EYE_COLUMNS)], ["---"] * (len(HEAD_AND_EYE_COLUMNS) + 1)]
    for name, by_split in tables.items():
        for split, result in by_split.items():
            orders = [result.rank_orders.get(each.metric) for each in HEAD_AND_EYE_COLUMNS]
            cells = [f"{each.tau:+.2f}" if each else "" for each in orders]
            lines.append([f"{TABLES[name].title.partition(':')[0].partition(',')[0]}, {split}", *cells])
    return "\n".join([ORDERS, *map(markdown_row, lines), ""])


def options(arguments: Sequence[str]) -> TableOptions:
    """The options: tables=..., and those of table_runs.py. A given experiment is composed on top of those of the
    tables."""
    wanted = parse_arguments(arguments, ["tables"])
    names = wanted.words["tables"] or list(TABLES)
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        raise InputError(f"tables: should be among {', '.join(TABLES)}; got {unknown[0]!r}")
    more = [text.partition("=")[2] for text in wanted.overrides if text.startswith("experiment=")]
    rest = [text for text in wanted.overrides if not text.startswith("experiment=")]
    experiment = f"experiment=[{','.join([*names, *more])}]"
    return replace(wanted, overrides=[experiment, *rest], words={"tables": names})


def _figures(by_name: Mapping[str, Sequence[RowResult]]) -> dict[str, dict[str, dict[str, MultiSeedStatistic]]]:
    """{split: {row: {metric: statistic}}}."""
    plain = {name: [json.loads(one.figures.read_text()) for one in seeds] for name, seeds in by_name.items()}
    return {split: {name: row_metrics(seeds, split) for name, seeds in plain.items()} for split in SPLITS}


def _tables(
    name: str, figures: Mapping[str, Mapping[str, Mapping[str, MultiSeedStatistic]]], settings: EvaluateSettings
) -> dict[str, TableResult]:
    """The results of a table in every split that has sounds."""
    return {
        split: table_result(TABLES[name], of_split, settings.bootstrap)
        for split, of_split in figures.items()
        if any(of_split.values())
    }


if __name__ == "__main__":
    run_command(main)
