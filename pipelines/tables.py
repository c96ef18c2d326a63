"""The paper's tables on three seeds: TalkingEyes Tables III, V (with II as ranges), VI and VII.

Run     python -m pipelines.tables [tables=table3,table7] [seeds=0,1,2] [--out DIR] [overrides]
Reads   conf/experiment/table3, table5, table6, table7; corpus, fit and embedding of `make repro` are taken over if they
        are the same
Writes  DIR (by default docs/): tables.md, tables.json; works in the folder that `workspace` names (build/tables)

A row is computed once, in however many tables it stands. "Seeds" are those of training and sampling; corpus, fit,
codebooks and critic are the same for all. Killed, it goes on (pipelines/table_runs.py). Outside the default chain.
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

Written by `python -m pipelines.tables{words}` (`make tables`) at revision {revision}; killed, it goes on. What each
table asks, and the paper's numbers: conf/experiment/table3, table5, table6, table7. All rows are of one code
revision: the store keeps what was made from other code under other names.

Why the paper's order is not found in the columns of the eyes: its own eyes stand still here after 400 steps (Tables III
and V to VII); predictions, and the experiment that tested them, are in the [log](log.md), "why the paper's order is not
ours"; what ten times the steps, free running and mixed heads give: "the experiments that were left". The default model
is told who speaks, of unseen speakers that it is somebody it knows, drawn for each sound; the paper's models and the
baselines are told nobody.

Seeds of training and sampling: {seeds}. Each figure (bold) is their mean; small, its {level:.0%} interval over clips
(seeds averaged) and, of several seeds, their range. Under it the paper's, of another corpus, encoder and critic, and of
some 480,000 steps of training: compare the order of rows, not the values. Diversity, Corr. and L2 compare with fitted
motion in radians, speeds and ranges with the true motion; `Mean` wins every L2, so read all of a row. Table II is in
words in the paper (a VAE's eyes "nearly stationary", a VQ-VAE's head "exaggerated"); here it is the middle 95 % of each
rotation against the truth's. What is above 5 Hz is measured on {count} motions of {long_s:.0f} s a split, for real
motion clip by clip; its intervals are over motions.

Order: of every two rows that the paper has with different numbers, whether ours differ in the same direction; Kendall's
tau is agreeing less reversed pairs over all. A pair is told apart if the interval of our difference, both rows on the
same clips, does not hold 0. Pairs are named as the paper orders them.

"""


def main() -> None:
    """All seeds of all rows of the chosen tables, then the page."""
    wanted = options(sys.argv[1:])
    names, made = wanted.words["tables"], configs_by_seed(wanted.overrides, wanted.seeds)
    settings = EvaluateSettings.model_validate(made[0]["evaluate"])
    models = tuple(dict.fromkeys(row for name in names for row in TABLES[name].rows))
    kind = RowSpec("table_row", ROW_CODE, READS, ("evaluate",), measure_row, models, REFERENCES)
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
    """What is asked for: tables=..., and what rows.py knows. An experiment is composed on top of the tables'."""
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
    """{split: {row: {figure}}}."""
    plain = {name: [json.loads(one.figures.read_text()) for one in seeds] for name, seeds in by_name.items()}
    return {split: {name: row_metrics(seeds, split) for name, seeds in plain.items()} for split in SPLITS}


def _tables(
    name: str, figures: Mapping[str, Mapping[str, Mapping[str, MultiSeedStatistic]]], settings: EvaluateSettings
) -> dict[str, TableResult]:
    """A table in every split that has sounds."""
    return {
        split: table_result(TABLES[name], of_split, settings.bootstrap)
        for split, of_split in figures.items()
        if any(of_split.values())
    }


if __name__ == "__main__":
    run_command(main)
