"""ProbTalk3D's Table 1 with its ablation: every model of the face in conf/experiment/probtalk3d_table, three seeds.

Run     python -m pipelines.face_table [--out DIR] [overrides], e.g. seeds=0 for one seed of all, or experiment=tiny
Reads   conf/; the corpus, fit and embedding that `make repro` made are taken over if they are the same
Writes  DIR (by default docs/): face_table.md, face_table.json, pictures/face-heat.png, pictures/face-emotions-model.png
Killed, it goes on: every model, its samples and its row are kept under `store` (store.py), so nothing is made twice.

"Seeds" are those of training and sampling; corpus, fit and stage 1 are the same for all. Models run side by side, one a
process. Outside the default chain.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pipelines.evaluate import Sources, items
from pipelines.evaluate_face import REAL, FaceSources, measure_faces, stacked_faces
from talkingeyes.audio.annotation import EMOTIONS, INTENSITIES
from talkingeyes.config import compose
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.errors import InputError
from talkingeyes.head.anny import open_head
from talkingeyes.learning.face_trained import FaceGenerator, load_face_generator
from talkingeyes.metrics.evaluation import EvaluateSettings
from talkingeyes.metrics.face.pictures import emotion_sheet, heat_sheet
from talkingeyes.metrics.face.row import FaceFigures, summarise_seeds
from talkingeyes.metrics.face.surface import Surface
from talkingeyes.metrics.face.table import SPLITS, TITLES, face_markdown
from talkingeyes.metrics.face.talking import Talking
from talkingeyes.metrics.face.vertices import VertexErrors
from talkingeyes.models.face.style import NEUTRAL, Style, StyleKey
from talkingeyes.recipe import CHECKOUT, Call, recipe
from talkingeyes.run import Report, Workspace, clip_parallel, each, shell
from talkingeyes.store import Entry, obtain

EXPERIMENT = "experiment=probtalk3d_table"
SEEDS = (0, 1, 2)
# What a row follows from beside what it reads.
ROW_CODE = (
    "pipelines/evaluate_face.py",
    "pipelines/face_table.py",
    "src/talkingeyes/metrics/face",
    "src/talkingeyes/head",
)
HEATED = ("truth", "probtalk3d", "face_vae", "face_ddim", "face_codes", "face_mean")
HEAT_PX, TILE_PX, MOMENTS = 220, 120, 6
SHOWN = "probtalk3d"  # the model on the sheet of emotions
INTRODUCTION = """# The face: ProbTalk3D's Table 1

Written by `python -m pipelines.face_table` (`make face`), which goes on where it was killed. The models:
[face_models.md](face_models.md).

Seeds of training and sampling: {seeds}. Each figure is their mean; small, its 95 % interval over sounds and, of several
seeds, their range. On the vertices of the open head, in millimetres, against the true motion (its first take); ten
samples a sound. Definitions and what each cannot tell: [face_measures.md](face_measures.md). The last column are the
paper's numbers on 3DMEAD and FLAME, read as metres and square metres: compare the order of rows, not the values.

"""


PICTURES = """### How much each vertex moves from frame to frame (its Fig. 6)

![Mean and SD of motion](pictures/face-heat.png)

### One sentence in eight emotions (its Fig. 7)

![Emotions](pictures/face-emotions-model.png)
"""


@dataclass(frozen=True)
class Made:
    """A row under one seed: where its figures are, and of a model its samples and the model itself."""

    name: str
    figures: Path
    samples: Path | None = None
    model: Path | None = None


def rows_of(params: Mapping[str, Any]) -> list[str]:
    """The models that give a face, and nothing else."""
    return [name for name, model in params["model"].items() if tuple(model["parts"]) == ("face",)]


def shared(params: Mapping[str, Any]) -> list[Call]:
    """What all rows and seeds share."""
    priors = {params["model"][name]["prior"] for name in rows_of(params)} - {None}
    order = [("synthesize",), ("fit",), ("embed",), *(("pretrain", prior) for prior in sorted(priors))]
    return recipe(params, order)


def main() -> None:
    """All seeds of all models, then the page and the pictures."""
    arguments = sys.argv[1:]
    out, seeds, overrides = options(arguments)
    made = [compose([*overrides, f"train.seed={seed}", f"sample.seed={seed}"]) for seed in seeds]
    params = made[0]
    entries: dict[Path, Entry] = {}
    for call in shared(params):
        entries[call.folder] = _obtain(params, call, entries)
    work = [(params, name) for name in REAL] + [(of_seed, name) for of_seed in made for name in rows_of(of_seed)]
    by_name: dict[str, list[Made]] = {}
    for one in each(partial(_row, entries), work, params["machine"]["jobs"], "face: rows"):
        by_name.setdefault(one.name, []).append(one)
    settings = EvaluateSettings.model_validate(params["evaluate"])
    table = {name: _summary(seeds, settings) for name, seeds in by_name.items()}
    (out / "pictures").mkdir(parents=True, exist_ok=True)
    (out / "face_table.json").write_text(json.dumps(table, indent=1))
    introduction = INTRODUCTION.format(seeds=", ".join(map(str, seeds)))
    (out / "face_table.md").write_text(introduction + face_markdown(table) + PICTURES)
    data = {folder.parts[1]: entry.output for folder, entry in entries.items()}
    _draw(out / "pictures", data, {name: seeds[0] for name, seeds in by_name.items()})
    print(face_markdown(table))


def options(arguments: Sequence[str]) -> tuple[Path, list[int], list[str]]:
    """Where to write, which seeds, and what is set in conf/. Raises InputError for seeds that are none."""
    left, out = list(arguments), CHECKOUT / "docs"
    if "--out" in left:
        at = left.index("--out")
        if at + 1 == len(left):
            raise InputError("--out: should name a folder, got none")
        out = Path(left[at + 1])
        left[at : at + 2] = []
    given = [text.removeprefix("seeds=") for text in left if text.startswith("seeds=")]
    try:
        seeds = [int(seed) for text in given for seed in text.split(",")] or list(SEEDS)
    except ValueError:
        raise InputError(f"seeds: should be numbers such as seeds=0,1,2, got {given[0]!r}") from None
    overrides = [text for text in left if not text.startswith("seeds=")]
    return out, seeds, overrides if any("experiment=" in text for text in overrides) else [EXPERIMENT, *overrides]


def _obtain(params: Mapping[str, Any], call: Call, upstream: Mapping[Path, Entry]) -> Entry:
    def make(of: Call, workspace: Workspace) -> Report:
        print("==", of.stage, *of.names, file=sys.stderr)
        with clip_parallel(params["machine"]):
            report: Report = importlib.import_module(f"pipelines.{of.stage}").run(workspace, *of.names)
        return report

    return obtain(Path(params["store"]), call, params, upstream, make)


def _row(shared_entries: Mapping[Path, Entry], work: tuple[Mapping[str, Any], str]) -> Made:
    """Train, sample and measure one model of one seed; real motion is measured alone."""
    params, name = work
    entries = dict(shared_entries)
    if name not in REAL:
        for call in recipe(params, [("train", name), ("sample", name)]):
            entries[call.folder] = _obtain(params, call, entries)
    reads = ("data/fit", "data/synthesize", "data/embed", *([] if name in REAL else [f"data/sample/{name}"]))
    call = Call("face_row", name, reads, ROW_CODE, ("evaluate",))
    figures = obtain(Path(params["store"]), call, params, entries, _measure).output / "figures.json"
    made = [entries[Path("data", stage, name)].output for stage in ("sample", "train") if name not in REAL]
    return Made(name, figures, *made)


def _measure(call: Call, workspace: Workspace) -> Report:
    """The figures of a row, sound by sound."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    places = (workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", row))
    sounds = [item.takes for item in items(Sources("fitted", *places, settings.benchmarked), settings)]
    sources = FaceSources(row, workspace.corpus, data("fit"), data("sample", row), settings.seed)
    figures = measure_faces(sources, sounds, workspace.jobs)
    rows = [{"split": takes[0].split, **asdict(one)} for takes, one in zip(sounds, figures, strict=True)]
    with workspace.output(call.stage, row) as folder:
        (folder / "figures.json").write_text(json.dumps(rows))
    return Report()


def _summary(seeds: Sequence[Made], settings: EvaluateSettings) -> dict[str, Any]:
    """{split: {"face": figures}} of a row under all its seeds."""
    by_seed = [json.loads(one.figures.read_text()) for one in seeds]
    found = {}
    for split in SPLITS:
        here = [[_figures(row) for row in rows if row["split"] == split] for rows in by_seed]
        if here[0]:
            summary = summarise_seeds(here, settings.bootstrap)
            found[split] = {"face": {name: asdict(estimate) for name, estimate in summary.items()}}
    return found


def _figures(row: Mapping[str, Any]) -> FaceFigures:
    errors = VertexErrors(**row["errors"]) if row["errors"] else None
    rest = {name: row[name] for name in ("diversity", "diversity_truth", "emotion", "hits")}
    return FaceFigures(errors=errors, talking=Talking(**row["talking"]), **rest)


def _draw(folder: Path, data: Mapping[str, Path], made: Mapping[str, Made]) -> None:
    """Heat maps of truth and a few models, and one model's sheet of emotions, for the first neutral sound of test."""
    corpus = Corpus(data["synthesize"])
    clips = sorted(corpus.select("test", take=0), key=lambda clip: (clip.intensity, clip.id))
    if not clips:
        return
    clip, surface = clips[0], Surface(open_head())
    shown = {"Truth": stacked_faces([corpus.truth(clip)])}
    for name in HEATED:
        samples = made[name].samples if name in made else None
        if samples is not None:
            shown[TITLES[name]] = FaceSamples.load(sharded(samples, clip.id, ".npz"))
    Image.fromarray(heat_sheet(surface, shown, HEAT_PX)).save(folder / "face-heat.png")
    model = made[SHOWN].model if SHOWN in made else None
    if model is not None:
        felt = in_emotions(load_face_generator(model), data["embed"], clip)
        times_s = [(at + 0.5) * clip.seconds / MOMENTS for at in range(MOMENTS)]
        Image.fromarray(emotion_sheet(surface.model, felt, times_s, TILE_PX)).save(folder / "face-emotions-model.png")


def in_emotions(generator: FaceGenerator, embed: Path, clip: Clip) -> dict[str, FaceSamples]:
    """One sample of the same speech and speaker in every emotion, strong."""
    embedding = np.load(sharded(embed / "speech", clip.sound, ".npy"))
    speaker = clip.speaker if clip.speaker in generator.vocabulary.speakers else None
    styles = {name: Style(speaker, name, 0 if name == NEUTRAL else max(INTENSITIES)) for name in EMOTIONS}
    return {name: generator.generate(embedding, [StyleKey(0.0, one)], [0], clip.fps) for name, one in styles.items()}


if __name__ == "__main__":
    shell(importlib.import_module("pipelines.face_table").main)  # by its name, so that worker processes find `_row`
