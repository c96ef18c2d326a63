"""Measure the release models on a sealed corpus, and append the figures to docs/releases.md.

Run     make release-report        (python -m pipelines.release_report), after make release-models
Reads   build/release: the models, their twins without speech, the critics
Writes  build/sealed: a corpus of 300 sounds of 50 people from a seed of its own; docs/releases.md

Every other stage refuses this corpus (`Workspace.corpus`), so that nothing is chosen by its figures.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from pipelines import embed, evaluate, fit, information, sample, synthesize
from talkingeyes.animation.model_file import ASSETS
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.sound_groups import group_sounds
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.table import from_json
from talkingeyes.evaluation.model_selection.information import information_table
from talkingeyes.evaluation.model_selection.validation_metrics import ValidateSettings
from talkingeyes.evaluation.paper_metrics.requirements import model_requirements, model_requirements_table
from talkingeyes.evaluation.paper_metrics.table3 import TITLES
from talkingeyes.orchestration.config import compose, write_params
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import SEAL, Workspace, parallel_map, run_command

RELEASE, SEALED, PAGE = Path("build/release"), Path("build/sealed"), Path("docs/releases.md")
REFERENCES = ("truth", "fitted", "mismatched")
BASELINES = ("random", "similar")
MODELS = ("talkingeyes_events", "talkingeyes_live")
SPLIT = "unseen"


def run() -> None:
    """Make the corpus if it is not there, measure every row, and append a section."""
    for name in (*BASELINES, *MODELS):
        if not (RELEASE / "data/train" / name).is_dir():
            raise InputError(f"{RELEASE}: should hold the model {name}, got none; `make release-models` trains it")
    workspace = _sealed_workspace()
    rows = {}
    for name in (*REFERENCES, *BASELINES, *MODELS):
        if name not in REFERENCES:
            _link(workspace, "train", name)
            sample.run(workspace, name)
        evaluate.run(workspace, name)
        rows[name] = json.loads(workspace.data("evaluate", name, "metrics.json").read_text())
    benchmarks = {
        name: from_json(json.loads(workspace.data("evaluate", name, "benchmark.json").read_text())) for name in rows
    }
    informed = {name: _information(workspace, name) for name in MODELS}
    required = {
        name: [each for each in model_requirements(rows, benchmarks, name) if not each.name.startswith("test:")]
        for name in rows
    }
    section = _section(model_requirements_table(required), information_table(informed, TITLES))
    with atomic_write(PAGE) as path:
        path.write_text(PAGE.read_text() + section)
    print(section)


def _sealed_workspace() -> Workspace:
    """The sealed corpus with its fitted motion and features, and the critics of the release. All of it is unseen."""
    params = compose(["experiment=sealed"])
    workspace = Workspace(SEALED, params)
    corpus = Corpus(workspace.data("synthesize"))
    seal = corpus.root / SEAL
    if not seal.exists():
        for stage in (synthesize, fit, embed):
            stage.run(workspace)
        corpus.write_index([replace(clip, split=SPLIT) for clip in corpus.clips])
        seal.touch()
        write_params(SEALED / "params.yaml", params)
    _link(workspace, "critic")
    return replace(workspace, may_read_sealed=True)


def _link(workspace: Workspace, *parts: str) -> None:
    place = workspace.data(*parts)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.unlink(missing_ok=True)
    place.symlink_to((RELEASE / "data").joinpath(*parts).resolve())


def _information(workspace: Workspace, name: str) -> dict[str, Any]:
    """Information that speech gives the model about the sealed motion; its twin is that of the stage `information`."""
    settings, data = workspace.settings("validate", ValidateSettings), workspace.data
    corpus, fitted, features = workspace.corpus, data("fit"), data("embed")
    twin = RELEASE.resolve() / "data/information" / name / "without_speech"
    paths = information.InputPaths(corpus, fitted, features, data("train", name), twin)
    sounds = group_sounds(Corpus(corpus), fitted, features, (SPLIT,), 1, settings.seed)
    found = list(parallel_map(partial(information.score_sound, paths), sounds, workspace.jobs, f"information {name}"))
    return information.summarise(found, settings)


def _section(requirements: str, informed: str) -> str:
    files = "\n".join(
        f"- `{path.name}`: sha256 `{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}`"
        for path in sorted(ASSETS.iterdir())
        if path.suffix == ".safetensors"
    )
    corpus = hashlib.sha256((SEALED / "data/synthesize/clips.parquet").read_bytes()).hexdigest()[:16]
    return f"""
## {date.today().isoformat()}, revision {revision()}

Packaged files, trained by `make release-models` (half precision there, single precision here):

{files}

Sealed corpus: sha256 of its index `{corpus}`.

### Information that speech gives about motion, nats per second

{informed}

### Requirements

{requirements}
"""


if __name__ == "__main__":
    run_command(run)
