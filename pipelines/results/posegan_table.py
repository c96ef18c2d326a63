"""Tables of personal head motion (Zhang et al., Tables 1 to 3, their ablations), and every head with one gaze decoder.

Run: python -m pipelines.results.posegan_table [--seeds 0,1,2] [--workspace build/posegan] [overrides]

The gaze benchmark, half of the time, can be omitted (--without-gaze) or computed for fewer seeds (--gaze-seeds 0).

Reads conf/ (experiment=posegan, or that of the overrides, such as experiment=posegan_tiny) and the corpus that it
makes, or another by corpus=DIR fit=video (talkingeyes track). Trains what the result store does not contain; an
interrupted run resumes.

Writes in the workspace: seed-N/data/..., measured/seed-N.json (recomputed when a model has changed),
posegan_table.md and posegan_table.csv, to be copied to docs/.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipelines.experiment import run_pipeline
from pipelines.results.result_tables import ResultTable, as_csv, read_tables
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import CHECKSUMS_FILE, Workspace, run_command
from talkingeyes.orchestration.stage_graph import DEFAULT_CORPUS

HEADS = ("head_mean", "head_random", "head_similar", "head_cnn", "head_vae", "head_vqvae", "posegan")
ABLATIONS = (
    "posegan_without_motion",
    "posegan_without_initial_pose",
    "posegan_motion_discriminator",
    "posegan_speech_discriminator",
)
GAZE = tuple(f"{name}_then_gaze" for name in HEADS)
INTRODUCTION = """# Personal head motion: the tables

Written by `python -m pipelines.results.posegan_table` (build/posegan/); an interrupted run resumes. Models, metrics
and what the figures say: [posegan.md](../posegan.md). Means over the seeds {seeds} of training and sampling.
[posegan_table.csv](posegan_table.csv) has every table with the range of the seeds, also by speaker, for noisy speech
and other languages, for style transfer, and for all heads with one gaze decoder on the gaze benchmark.

Corpus, the SVM of Table 1 and the classifier of Table 3 are the same for all seeds. The paper's speakers are from web
videos, ours are synthetic: compare the order of rows, not the values.

"""
# Sections of the page and their columns (none: all).
SHOWN: dict[str, tuple[str, ...]] = {
    "Table 1: fraction of windows accepted by the one-class SVM": (),
    "Table 2: distance of pose and of motion": ("method", "pose", "motion", "paper: pose", "paper: motion"),
    "Table 3: confidence of the classifier in the intended speaker": ("method", "mean", "accuracy", "paper's mean"),
    "Head motion and ablations": (
        "method",
        "range (relative to true)",
        "speed",
        "acceleration",
        "power above 5 Hz",
        "speed at window boundaries",
        "parameters",
        "training, CPU s",
    ),
}
# New speakers of other languages: for style transfer, and for robustness to unfamiliar sounds.
NEW_SPEAKERS = ("synthesize.languages=[fr,de]", "synthesize.seed=1", "synthesize.speakers=10", "synthesize.clips=20")


def main() -> None:
    """Train, evaluate and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0,1,2", help="seeds of training and sampling, such as 0,1,2")
    parser.add_argument("--workspace", type=Path, default=Path("build/posegan"), help="working folder")
    parser.add_argument("--without-gaze", action="store_true", help="omit the gaze benchmark (half of the time)")
    parser.add_argument("--gaze-seeds", help="fewer seeds for the gaze benchmark, such as 0")
    parser.add_argument("overrides", nargs="*", help="overrides of conf/, such as experiment=posegan_tiny")
    given = parser.parse_args()
    seeds = [int(each) for each in given.seeds.split(",")]
    of_gaze = [int(each) for each in (given.gaze_seeds or given.seeds).split(",")] if not given.without_gaze else []
    conf = with_experiment(given.overrides)
    new_speakers = _strangers(given.workspace, conf)
    found = {}
    for seed in seeds:
        view = _trained(given.workspace, conf, seed, seed in of_gaze)
        found[seed] = _measured(given.workspace, view, new_speakers, seed)
    benchmark = _benchmark(given.workspace, of_gaze) if of_gaze else {}
    _write(given.workspace, found, benchmark)


def with_experiment(overrides: Sequence[str]) -> list[str]:
    """Overrides of conf/, with experiment=posegan unless they have another experiment."""
    return [
        *([] if any(each.lstrip("+").startswith("experiment=") for each in overrides) else ["experiment=posegan"]),
        *overrides,
    ]


def _params(workspace: Path, conf: Sequence[str], seed: int, models: Sequence[str]) -> dict[str, Any]:
    params = compose((*conf, f"train.seed={seed}", f"sample.seed={seed}", f"workspace={workspace}"))
    params["model"] = {name: params["model"][name] for name in models}
    return params


def _trained(workspace: Path, conf: Sequence[str], seed: int, with_gaze: bool) -> Path:
    """The models of one seed, and the inputs of the gaze benchmark; CPU seconds of trainings are recorded."""
    view, cost = workspace / f"seed-{seed}", workspace / f"seed-{seed}" / "cpu_seconds.json"
    taken = json.loads(cost.read_text()) if cost.is_file() else {}
    models = (*HEADS, *ABLATIONS, "pgface")
    params = _params(workspace, conf, seed, models)
    run_pipeline({**params, "target": "train@head_mean"}, view)
    for name in models:
        before, marked = time.process_time(), _digest(view, name)
        run_pipeline({**params, "target": f"train@{name}"}, view)
        if _digest(view, name) != marked or name not in taken:
            taken[name] = time.process_time() - before
            cost.write_text(json.dumps(taken, indent=1))
    if with_gaze:
        compared = _params(workspace, conf, seed, (*HEADS, "talkingeyes_events", *GAZE))
        run_pipeline({**compared, "target": "evaluate"}, view)
    return view


def _strangers(workspace: Path, conf: Sequence[str]) -> Path:
    """The corpus of new speakers, and its embedding; synthetic, whatever the corpus."""
    view = workspace / "strangers"
    params = compose((*conf, *NEW_SPEAKERS, f"corpus={DEFAULT_CORPUS}", f"workspace={workspace}"))
    run_pipeline({**params, "model": {}, "target": "embed"}, view)
    return view


def _digest(view: Path, name: str) -> str:
    path = view / "data" / "train" / name / CHECKSUMS_FILE
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _measured(workspace: Path, view: Path, new_speakers: Path, seed: int) -> dict[str, Any]:
    """All metrics of one seed's models; from the file if it is up to date."""
    from talkingeyes.evaluation.papers.posegan_metrics import PoseInputPaths, evaluate_models

    path = workspace / "measured" / f"seed-{seed}.json"
    key = [_digest(view, name) for name in (*HEADS, *ABLATIONS)]
    if path.is_file() and (content := json.loads(path.read_text()))["models"] == key:
        figures: dict[str, Any] = content["figures"]
        return figures
    data = PoseInputPaths(Workspace.open(view).corpus, view / "data", new_speakers / "data", HEADS, ABLATIONS)
    figures = {**evaluate_models(data, seed), "training_s": json.loads((view / "cpu_seconds.json").read_text())}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as partial:
        partial.write_text(json.dumps({"models": key, "figures": figures}, indent=1))
    return figures


def _benchmark(workspace: Path, seeds: Sequence[int]) -> dict[str, list[dict[str, Any]]]:
    """The gaze benchmark of every row, one per seed."""
    rows = ("truth", "fitted", "talkingeyes_events", *GAZE)
    folders = [workspace / f"seed-{seed}" / "data" / "evaluate" for seed in seeds]
    return {row: [json.loads((each / row / "benchmark.json").read_text()) for each in folders] for row in rows}


def _write(workspace: Path, found: dict[int, dict[str, Any]], benchmark: dict[str, list[dict[str, Any]]]) -> None:
    from pipelines.results.posegan_page import page

    tables = read_tables(page(list(found.values()), benchmark))
    (workspace / "posegan_table.csv").write_text(as_csv(tables.values()))
    path = workspace / "posegan_table.md"
    path.write_text(summary(tables, list(found)))
    print(path, file=sys.stderr)


def summary(tables: Mapping[str, ResultTable], seeds: Sequence[int]) -> str:
    """The page: the tables of the paper, and the motion of the head."""
    parts = [
        f"### {name}\n\n{tables[name].markdown(columns or tables[name].columns)}\n" for name, columns in SHOWN.items()
    ]
    return INTRODUCTION.format(seeds=", ".join(map(str, seeds))) + "\n".join(parts)


if __name__ == "__main__":
    run_command(main)
