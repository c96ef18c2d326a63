"""Every head generator with every gaze decoder, trained alike: cost and results of each combination in one table.

Run     python -m pipelines.combinations [seeds=0] [--out DIR] [overrides]; training steps:
        model.vae_head_base.loop.steps=200
Reads   conf/experiment/head_gaze_combinations; corpus, fit and embedding of `make repro` are reused if they match
Writes  DIR (by default docs/): combinations.md, combinations.json; works in the folder that `workspace` names
        (build/combinations)

Metrics are those of `validate`, on val, because the table is for model selection. Times are CPU seconds of this
machine. An interrupted run resumes (pipelines/table_runs.py); of an interrupted training, only the last part is
counted. Outside the default pipeline.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipelines.table_runs import (
    METRICS_FILE,
    RowResult,
    RowSpec,
    TableOptions,
    compute_rows,
    configs_by_seed,
    parse_arguments,
)
from talkingeyes.corpus.recordings import recordings
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import Report, Workspace, run_command
from talkingeyes.orchestration.stage_graph import StageCall
from talkingeyes.training.checkpoint import load
from talkingeyes.training.motion_generators import load_generator

HEADS = {
    "vae": "VAE",
    "causal_vae": "causal VAE",
    "vqvae": "VQ-VAE",
    "point_process": "point process (movement segments)",
}
GAZES = {
    "point_process": "point process",
    "categorical": "codes, sampled",
    "regression": "codes, regressed (the paper's)",
    "vae": "VAE",
}
CANONICAL = "vae_canonical_correlation"
TITLES = {f"{head}_{gaze}": (HEADS[head], GAZES[gaze]) for head in HEADS for gaze in GAZES} | {
    CANONICAL: (HEADS["vae"], "canonical correlation")
}
LENGTH_S, SAMPLES = 10.0, 10
ROW_CODE = ("pipelines/combinations.py", "src/talkingeyes/training", "src/talkingeyes/models")
# From keys of data/validate/<model>/metrics.json to column titles. FITTED holds the keys of the fitted motion.
VAL_METRICS = {
    "dynamics_distance": "distance of dynamics",
    "corr": "Corr. eyes",
    "corr_gaze_in_space": "Corr. space",
    "corr_head": "Corr. head",
    "metrics_worse": "metrics worse than truth",
}
FITTED = {name: name.replace("corr", "corr_fitted") for name in VAL_METRICS if name.startswith("corr")}
COLUMNS = ("head", "gaze", "parameters", "training, CPU s", "ten samples, CPU s")
INTRODUCTION = """# Every head generator with every gaze decoder

Written by `python -m pipelines.combinations{words}` at revision {revision}; an interrupted run resumes. The
combinations are defined in conf/experiment/head_gaze_combinations.yaml. To train one of them:
`python -m pipelines.experiment experiment=head_gaze_combinations target=validate@vae_point_process`.

Each is trained jointly for {steps} steps of {batch} windows, which is short: compare rows with each other only. Means
over the seeds {seeds}; the values of each seed are in [combinations.json](combinations.json).

`parameters` counts all numbers of the checkpoint. Times are CPU seconds of one process: training without the codebooks,
and ten samples of {length_s:g} s of head and gaze from embedded speech. The other columns are measured on val.
The distance of dynamics is that of eye speeds and saccade amplitudes from the truth's, in standard deviations. Corr.
should be close to that of the fitted motion, not above it. Metrics worse than truth are those of the gaze benchmark
beyond their interval of {level:.0%}, or without enough events{metrics_count}.

"""
LEFT_OUT = """
Not in the table:

- Canonical correlation with other heads: its gaze is a function of the head (that of `vae_point_process`).
- Heads trained alone, such as PoseGAN: [posegan_table.md](posegan_table.md) has all of them with one decoder.
- Baselines (mean, random, similar): they take head and gaze from one motion.
- Streaming: all decoders here use future speech. Only `talkingeyes_live` can be streamed ([live.md](live.md)).
"""


def main() -> None:
    """Compute all combinations with all seeds, then write the page."""
    wanted = options(sys.argv[1:])
    made = configs_by_seed(wanted.overrides, wanted.seeds)
    kind = RowSpec("combination_metrics", ROW_CODE, (), (), _measure, tuple(TITLES), (), stages_after=("validate",))
    table = _table(compute_rows(made, kind, critic=True, title="combinations").by_name)
    text = page(table, made[0], " ".join(["", *sys.argv[1:]]), wanted.seeds)
    wanted.out.mkdir(parents=True, exist_ok=True)
    (wanted.out / "combinations.json").write_text(json.dumps({"seeds": wanted.seeds, "rows": table}, indent=1))
    (wanted.out / "combinations.md").write_text(text)
    print(text)


def options(arguments: Sequence[str]) -> TableOptions:
    """The options, with one seed by default. A given experiment is composed on top of that of the combinations."""
    wanted = parse_arguments(arguments)
    seeds = wanted.seeds if any(text.startswith("seeds=") for text in arguments) else [0]
    more = [text.partition("=")[2] for text in wanted.overrides if text.startswith("experiment=")]
    rest = [text for text in wanted.overrides if not text.startswith("experiment=")]
    return replace(
        wanted, seeds=seeds, overrides=[f"experiment=[{','.join(['head_gaze_combinations', *more])}]", *rest]
    )


def _measure(call: StageCall, workspace: Workspace) -> Report:
    """Cost of one combination, and its metrics on val."""
    (row,), data = call.names, workspace.data
    clip = recordings(Corpus(workspace.corpus), data("fit"), data("embed"), "val", take=0)[0]
    frames = round(LENGTH_S * clip.clip.fps)
    speech = np.tile(np.asarray(clip.speech), (-(-frames // len(clip)), 1))[:frames]
    generator, seeds = load_generator(data("train", row)), list(range(SAMPLES))
    generator.generate(speech[: frames // 5], seeds[:1], clip.clip.fps)  # warm-up, not counted
    taken = {}
    for name, sample_seeds in (("one_cpu_s", seeds[:1]), ("ten_cpu_s", seeds)):
        start = time.process_time()
        generator.generate(speech, sample_seeds, clip.clip.fps)
        taken[name] = time.process_time() - start
    figures = {
        "parameters": sum(tensor.numel() for tensor in load(data("train", row)).tensors.values()),
        **taken,
        "val": json.loads(data("validate", row, "metrics.json").read_text()),
    }
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps(figures))
    return Report()


def _table(by_name: Mapping[str, Sequence[RowResult]]) -> dict[str, list[dict[str, Any]]]:
    """Metrics of every combination and seed, with the CPU seconds of its training."""
    return {
        name: [{**json.loads(one.figures.read_text()), "training_cpu_s": one.training_cpu_s} for one in seeds]
        for name, seeds in by_name.items()
    }


def page(
    table: Mapping[str, Sequence[Mapping[str, Any]]], params: Mapping[str, Any], words: str, seeds: Sequence[int]
) -> str:
    """The table as Markdown, with its settings and the excluded combinations."""
    loop = params["model"][next(name for name in table if name != CANONICAL)]["loop"]
    of = sorted({seed["val"]["metrics_comparable"] for found in table.values() for seed in found})
    introduction = INTRODUCTION.format(
        words=words,
        revision=revision(),
        seeds=", ".join(map(str, seeds)),
        steps=loop["steps"],
        batch=loop["batch"],
        length_s=LENGTH_S,
        level=params["validate"]["bootstrap"]["confidence_level"],
        metrics_count=f"; of {of[0]:.0f}" if len(of) == 1 else f"; of {of[0]:.0f} to {of[-1]:.0f}",
    )
    head = [*COLUMNS, *VAL_METRICS.values()]
    lines = [_fitted(next(iter(table.values()))), *(_line(name, found) for name, found in table.items())]
    return introduction + markdown_table(head, lines) + "\n" + LEFT_OUT


def _fitted(seeds: Sequence[Mapping[str, Any]]) -> list[str]:
    """Row of the fitted motion on val, the reference value of Corr."""
    cells = [f"{seeds[0]['val'][FITTED[name]]:.3f}" if name in FITTED else "" for name in VAL_METRICS]
    return ["*fitted motion*", *[""] * (len(COLUMNS) - 1), *cells]


def _line(name: str, seeds: Sequence[Mapping[str, Any]]) -> list[str]:
    trained = [seed["training_cpu_s"] for seed in seeds]
    known = [value for value in trained if value is not None]
    return [
        *TITLES[name],
        f"{seeds[0]['parameters']:,}",
        f"{np.mean(known):.0f}" if len(known) == len(trained) else "–",
        f"{np.mean([seed['ten_cpu_s'] for seed in seeds]):.2f}",
        *(
            f"{np.mean([seed['val'][each] for seed in seeds]):.{0 if each == 'metrics_worse' else 3}f}"
            for each in VAL_METRICS
        ),
    ]


if __name__ == "__main__":
    run_command(main)
