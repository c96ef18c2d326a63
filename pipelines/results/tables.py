"""The paper's tables and claims: TalkingEyes Tables III, V (with II as ranges), VI and VII.

Run     python -m pipelines.results.tables [tables=table3,table7] [seeds=0,1,2] [--out DIR] [overrides]
Reads   conf/experiment/paper_tables.yaml; corpus, fit and embedding of `make repro` are reused if they match
Writes  DIR (by default docs/): tables_seeds/TABLE-SEED.json, then tables.md and tables.json of all files in
        tables_seeds; works in the folder that `workspace` names (build/tables)

Each table of each seed is a file of its own, written when it is ready: tables and seeds can be computed at different
times and on different machines, if their settings are equal. Seeds are those of training and sampling, in Table VII
also of the codebooks; corpus, fit, critic and the other codebooks are shared. A row is computed once, even if it is in
several tables. An interrupted run resumes (pipelines/results/table_runs.py). Outside the default pipeline.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipelines.evaluate import SPLITS
from pipelines.results.paper_table_rows import LONG_S, LONG_SPEAKERS, READS, ROW_CODE, measure_row
from pipelines.results.table_runs import (
    RowResult,
    RowSpec,
    TableOptions,
    compute_rows,
    configs_by_seed,
    configuration_hash,
    parse_arguments,
    read_seed_results,
)
from pipelines.results.tables_page import Results, as_json, page
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.papers.talkingeyes_claims import CLAIMS, ordered_pairs
from talkingeyes.evaluation.papers.talkingeyes_metrics import EvaluateSettings
from talkingeyes.evaluation.papers.talkingeyes_results import (
    Comparison,
    SeedResult,
    from_json,
    row_metrics,
    split_result,
    to_json,
)
from talkingeyes.evaluation.papers.talkingeyes_tables import FAMILIES, REFERENCES, TABLES
from talkingeyes.evaluation.text_tables import training_budget
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import run_command

SEEDS_FOLDER = "tables_seeds"
# Sections of the composition that every row depends on; models and codebooks are added by name.
SHARED_SECTIONS = ("corpus", "synthesize", "fit", "embed", "critic", "sample", "evaluate")
INTRODUCTION = """# The paper's tables

Written by `python -m pipelines.results.tables` (`make tables`; 10 to 25 minutes a table and seed on two cores; an
interrupted run resumes) from the results of single seeds in docs/results/tables_seeds, at revision {revisions}. Rows,
questions and the paper's values: conf/experiment/paper_tables.yaml. This page shows new speakers (split `unseen`).
[tables.json](tables.json) has both splits and all metrics, with 95 % intervals over sounds and over speakers, and the
range of the seeds.

Rows are of two families. *Features regressed* has the paper's decoder, which regresses features frame by frame, and one
latent code of the head per clip; not as printed are its losses (means over standardised numbers), its codebook (moving
averages), its attention (25 frames to each side) and its budget. The recipe as printed (`experiment=paper_literal`) is
measured apart: its eyes freeze, too ([log](../log/2026-11-24-paper-literal.md)). *Codes in sequence* samples codes of 4
frames of gaze in space, as categories, after a VAE head with a code per half second. Both train with the same steps,
batch and learning rate.

In brackets is the paper's value, of another corpus, encoder and critic, and of about 480,000 training steps: compare
the order of rows, not the values. Diversity, Corr. and L2 (radians) compare with fitted motion, speeds and ranges with
the true motion. A constant pose has the lowest L2, so read whole rows. Table II of the paper is a description; here it
is the middle 95 % of each rotation over that of the truth. Motion above 5 Hz is measured on one motion of up to
{long_s:.0f} s for each of at most {speakers} speakers per split. `talkingeyes` and `talkingeyes_events` are conditioned
on the speaker; for unseen speakers, a random training speaker is used for each sound. All other models are
unconditional.

"""


def main() -> None:
    """Compute the chosen tables with all seeds, one file each, then write the page of all files."""
    wanted = options(sys.argv[1:])
    folder, configurations = wanted.out / SEEDS_FOLDER, configuration_hashes(wanted.overrides)
    read_results(folder, configurations)
    for seed in wanted.seeds:
        (params,) = configs_by_seed(wanted.overrides, [seed])
        for name in wanted.words["tables"]:
            result = compute(name, seed, params, configurations[name])
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(folder / f"{name}-{seed}.json") as temporary:
                temporary.write_text(json.dumps(to_json(result)) + "\n")
    results = read_results(folder, configurations)
    (wanted.out / "tables.json").write_text(json.dumps(as_json(results), indent=1) + "\n")
    (wanted.out / "tables.md").write_text(document(results))
    print(page(results))


def document(results: Results) -> str:
    """The whole page."""
    revisions = sorted({each.revision for seeds in results.values() for each in seeds})
    missing = [TABLES[name].title for name in TABLES if name not in results]
    note = f"Not computed yet: {'; '.join(missing)}.\n\n" if missing else ""
    introduction = INTRODUCTION.format(revisions=", ".join(revisions), long_s=LONG_S, speakers=LONG_SPEAKERS)
    return introduction + note + page(results)


def compute(name: str, seed: int, params: Mapping[str, Any], configuration: str) -> SeedResult:
    """Compute all rows of a table with one seed; `params` is the composition with this seed."""
    table, settings = TABLES[name], EvaluateSettings.model_validate(params["evaluate"]).bootstrap
    kind = RowSpec("table_metrics", ROW_CODE, READS, ("evaluate",), measure_row, tuple(table.rows), REFERENCES)
    measured = _measured(compute_rows([params], kind, critic=True, title=f"{name}, seed {seed}").by_name)
    rows = {split: {row: row_metrics(each, split) for row, each in measured.items()} for split in SPLITS}
    return SeedResult(
        table=name,
        seed=seed,
        configuration=configuration,
        revision=revision(),
        budgets={row: text for row in table.rows if (text := training_budget(params["model"][row]))},
        splits={
            split: split_result(table, of_split, comparisons(name), settings)
            for split, of_split in rows.items()
            if any(of_split.values())
        },
    )


def comparisons(name: str) -> list[Comparison]:
    """The pairs of rows of a table that its orders and the claims compare, in both families."""
    table = TABLES[name]
    ordered = [
        pair
        for family in FAMILIES
        for column in table.paper_columns
        for pair in ordered_pairs(table, family, column.metric)
    ]
    claimed = [
        pair
        for claim in CLAIMS
        if claim.table == name
        for family in FAMILIES
        for pair in claim.comparisons_of(family) or ()
    ]
    return list(dict.fromkeys([*ordered, *claimed]))


def configuration_hashes(overrides: Sequence[str]) -> dict[str, str]:
    """Hash of all settings that the rows of each table depend on, but for the seeds."""
    (params,) = configs_by_seed(overrides, [0])
    return {name: configuration_hash(params, SHARED_SECTIONS, table.rows) for name, table in TABLES.items()}


def read_results(folder: Path, configurations: Mapping[str, str] | None = None) -> Results:
    """The results of all files in a folder: by table, in the order of the paper, then by seed.

    Raises InputError as `read_seed_results`.
    """

    def parse(content: Any) -> tuple[str, SeedResult]:
        result = from_json(content)
        if result.table not in TABLES:
            raise KeyError(result.table)
        return result.table, result

    found = read_seed_results(folder, "pipelines.results.tables", parse, configurations)
    return {name: found[name] for name in TABLES if name in found}


def options(arguments: Sequence[str]) -> TableOptions:
    """The options: tables=..., and those of table_runs.py. A given experiment is composed on top of paper_tables."""
    wanted = parse_arguments(arguments, ["tables"])
    names = wanted.words["tables"] or list(TABLES)
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        raise InputError(f"tables: should be among {', '.join(TABLES)}; got {unknown[0]!r}")
    more = [text.partition("=")[2] for text in wanted.overrides if text.startswith("experiment=")]
    rest = [text for text in wanted.overrides if not text.startswith("experiment=")]
    experiment = f"experiment=[{','.join(['paper_tables', *more])}]"
    return replace(wanted, overrides=[experiment, *rest], words={"tables": names})


def _measured(by_name: Mapping[str, Sequence[RowResult]]) -> dict[str, Any]:
    """{row: what `measure_row` wrote}, of one seed."""
    return {name: json.loads(only.figures.read_text()) for name, (only,) in by_name.items()}


if __name__ == "__main__":
    run_command(main)
