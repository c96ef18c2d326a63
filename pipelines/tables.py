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
from talkingeyes.evaluation.multi_seed import MultiSeedStatistic
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.evaluation.tables.definitions import REFERENCES, TABLES
from talkingeyes.evaluation.tables.page import TableResult, as_json, markdown, table_result
from talkingeyes.evaluation.tables.row_metrics import row_metrics
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import run_command

INTRODUCTION = """# The paper's tables

Written by `python -m pipelines.tables{words}` (`make tables`) at revision {revision}; an interrupted run resumes. The
question of each table and the paper's values are in conf/experiment/table3, table5, table6, table7. All rows are of one
code revision, because the result store separates results of different code.

The paper's order is not reproduced in the columns of the eyes, because its eyes stand still here after 400 steps
(Tables III and V to VII). Predictions and the experiment that tested them are in the [log](log.md), "why the paper's
order is not ours". Results of ten times the steps, free running and mixed heads: "the experiments that were left". The
default model is conditioned on the speaker; for unseen speakers, a random training speaker is used for each sound. The
paper's models and the baselines are unconditional.

Seeds of training and sampling: {seeds}. Each value (bold) is the mean over seeds; in small print its {level:.0%}
interval over clips (seeds averaged) and, with several seeds, their range. Below it is the paper's value, of another
corpus, encoder and critic, and of about 480,000 training steps: compare the order of rows, not the values. Diversity,
Corr. and L2 compare with fitted motion in radians, speeds and ranges with the true motion. `Mean` wins every L2, so
read whole rows. The paper describes Table II in words (a VAE's eyes "nearly stationary", a VQ-VAE's head
"exaggerated"); here it is the middle 95 % of each rotation, compared with the truth. Motion above 5 Hz is measured on
{count} motions of {long_s:.0f} s per split, for real motion clip by clip; its intervals are over motions.

Order: for every pair of rows with different values in the paper, whether ours differ in the same direction. Kendall's
tau is the number of agreeing minus reversed pairs, divided by all pairs. A pair differs significantly if the interval
of our difference, with both rows on the same clips, excludes 0. Pairs are named in the paper's order.

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
    page = introduction + "\n".join(markdown(TABLES[name], by_split) for name, by_split in tables.items())
    plain = {"seeds": wanted.seeds, "tables": {name: as_json(TABLES[name], each) for name, each in tables.items()}}
    wanted.out.mkdir(parents=True, exist_ok=True)
    (wanted.out / "tables.json").write_text(json.dumps(plain, indent=1))
    (wanted.out / "tables.md").write_text(page)
    print(page)


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
