"""Write the packaged corpus of the gaze benchmark, and the page with the packaged models on it.

Run     python -m pipelines.benchmark_corpus        (two minutes)
Reads   conf/experiment/benchmark_corpus.yaml; the packaged models; data/critic and data/train of the default chain
Writes  src/talkingeyes/corpus/assets/benchmark.zip; docs/results/benchmark_corpus.md and .json; works in
        build/benchmark_corpus

Its sentences are of the part of the texts that the chain leaves for unseen speakers, and every sound has several takes.
Outside the default pipeline.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pipelines.synthesize import sound_jobs, synthesize_sound
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, PACKAGED_MODEL
from talkingeyes.audio.encoder import EmbedSettings, make_encoder
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.corpus.packed import EVALUATORS, PACKAGED, pack_corpus, unpack_corpus
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.measures.corr import CRITICS
from talkingeyes.evaluation.measures.critic import CriticSettings
from talkingeyes.evaluation.measures.motion_encoder import CHECKPOINT_NAME
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command
from talkingeyes.synthesis.plan import SynthesizeSettings
from talkingeyes.training.checkpoint import load, save
from talkingeyes.workflows.animate import AnimationOptions
from talkingeyes.workflows.animate_batch import animate_all
from talkingeyes.workflows.evaluate import evaluate

DOCS, SPLIT = Path("docs/results"), "unseen"
TRAINED = Path("data/train")
# All of them as `talkingeyes animate` writes them, with its rule-based layers.
MODELS = {
    "default": PACKAGED_MODEL,
    "live": PACKAGED_LIVE_MODEL,
    "similar": TRAINED / "similar",
    "untrained": TRAINED / "untrained",
}
PAGE = """# The packaged corpus of the gaze benchmark

```sh
talkingeyes benchmark-corpus corpus
```

writes {sounds} sounds of {speakers} speakers in {languages} languages, with {takes} true motions each. They come with
the package, so anybody measures on the same sounds ([evaluate.md](../evaluate.md)). Nothing is trained on them or
chosen by them. Written by `python -m pipelines.benchmark_corpus`.

Random motion is the true motion of another speaker under another sound. It moves as people do, and passes every metric
that does not ask whether motion follows its sound or its speaker, but for a few by chance: the intervals have 95 %,
and random motion is one draw. The table has the metrics in which it is worse than the truth: the others say how people
move, not when. Beside it are the models of the package (default, live) and two baselines of `make repro`, all as
`talkingeyes animate` writes them: Similar Sample, the motion of a training clip with similar speech, and the default
with random weights. Bold: worse than the truth by more than the interval.

{counts}

More sounds have narrower intervals, so compare these counts between columns, not with those of another corpus.
[benchmark_corpus.json](benchmark_corpus.json) has them all.

"""
RANDOM = "random"
COLUMNS = ("metric", "unit", "truth", *MODELS, RANDOM)
Numbers = Mapping[str, Any]


def main() -> None:
    """Synthesize and pack the corpus, animate its sounds with the packaged models, and write the page."""
    params = compose(["experiment=benchmark_corpus"])
    workspace = Workspace(Path(params["workspace"]), params)
    settings = workspace.settings("synthesize", SynthesizeSettings)
    jobs = [replace(job, split=SPLIT, takes=settings.takes) for job in sound_jobs(settings)]
    with workspace.output("synthesize") as folder:
        made = parallel_map(partial(synthesize_sound, folder, settings), jobs, workspace.jobs, "benchmark corpus")
        Corpus(folder).write_index([clip for takes in made for clip in takes])
        shutil.rmtree(folder / "rows")
    evaluators = write_evaluators(workspace)
    PACKAGED.parent.mkdir(exist_ok=True)
    with atomic_write(PACKAGED) as path:
        pack_corpus(Corpus(workspace.data("synthesize")), evaluators, path)
    numbers = measure(workspace)
    with atomic_write(DOCS / "benchmark_corpus.json") as path:
        path.write_text(json.dumps(numbers, indent=1) + "\n")
    with atomic_write(DOCS / "benchmark_corpus.md") as path:
        path.write_text(page(numbers))
    print(page(numbers))


def write_evaluators(workspace: Workspace) -> Path:
    """Write critics and encoder of the chain, and of the speech features those that the critics read."""
    trained, folder = Workspace.open(Path.cwd()).data("critic"), workspace.root / "evaluators"
    shutil.rmtree(folder, ignore_errors=True)
    for name in (*CRITICS.values(), CHECKPOINT_NAME):
        (folder / "critic" / name).mkdir(parents=True)
        checkpoint = load(trained / name)
        names = checkpoint.config.get("channels", ())  # none of the encoder
        channels = {"speech_channels": torch.arange(len(names))} if names else {}
        save(folder / "critic" / name, {**checkpoint.tensors, **channels}, checkpoint.config)
    settings = workspace.settings("critic", CriticSettings)
    corpus, encoder = Corpus(workspace.data("synthesize")), make_encoder(workspace.settings("embed", EmbedSettings))
    columns = [encoder.channels.index(name) for name in settings.channels]
    for clip in (each for each in corpus.clips if each.take == 0):
        features = encoder(corpus.speech(clip), clip.fps)[:, columns]
        np.save(make_shard_path(folder / "embed" / "speech", clip.sound, ".npy"), features, allow_pickle=False)
    statement = {"fps": corpus.clips[0].fps, "channels": settings.channels}
    (folder / "embed" / "embedding.json").write_text(json.dumps(statement))
    return folder


def measure(workspace: Workspace) -> dict[str, Any]:
    """Counts of the packed corpus, and the metrics of the packaged models and of random motion on it."""
    place = workspace.root / "unpacked"
    shutil.rmtree(place, ignore_errors=True)
    corpus = unpack_corpus(PACKAGED, place / "corpus")
    evaluators = corpus.root / EVALUATORS
    sounds = sorted((corpus.root / "speech").rglob("*.flac"))
    rows: dict[str, dict[str, Any]] = {}
    for name, model in MODELS.items():
        animate_all(sounds, place / name, AnimationOptions(previews=False), model=model, jobs=workspace.jobs)
        found = evaluate(place / name, corpus.root, evaluators=evaluators, jobs=workspace.jobs)
        rows[name] = _values(found.rows)
    rows[RANDOM] = _values(found.random)
    truth = {row.metric.name: row.reference.value for row in found.rows if row.reference}
    clips = corpus.clips
    counts = {
        "sounds": len(sounds),
        "takes": len(clips) // len(sounds),
        "speakers": len({clip.speaker for clip in clips}),
        "languages": len({clip.language for clip in clips}),
    }
    units = {row.metric.name: row.metric.unit for row in found.rows}
    return {**counts, "units": units, "truth": truth, "rows": rows}


def _values(rows: Sequence[MetricResult]) -> dict[str, dict[str, Any]]:
    return {row.metric.name: {"value": row.value.value, "worse": row.worse} for row in rows if row.value}


def page(numbers: Numbers) -> str:
    """The page of the numbers: the metrics that random motion fails."""
    rows = numbers["rows"]
    shown = [name for name, cell in rows[RANDOM].items() if cell["worse"]]
    judged = [name for name in rows[RANDOM] if all(name in each for each in rows.values())]
    groups = {
        "that random fails": [name for name in judged if name in shown],
        "that random passes": [name for name in judged if name not in shown],
    }
    counts = [
        [f"{len(names)} {title}", *(str(sum(each[name]["worse"] for name in names)) for each in rows.values())]
        for title, names in groups.items()
    ]
    lines = [
        [
            f"`{name}`",
            numbers["units"][name],
            f"{numbers['truth'][name]:.3g}",
            *(_cell(rows[each].get(name)) for each in rows),
        ]
        for name in shown
    ]
    introduction = {name: numbers[name] for name in ("sounds", "speakers", "languages", "takes")}
    worse = markdown_table(("metrics of all, worse in", *rows), counts)
    return PAGE.format(**introduction, counts=worse) + markdown_table(COLUMNS, lines) + "\n"


def _cell(found: Mapping[str, Any] | None) -> str:
    if found is None:
        return ""
    return f"**{found['value']:.3g}**" if found["worse"] else f"{found['value']:.3g}"


if __name__ == "__main__":
    run_command(main)
