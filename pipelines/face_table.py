"""ProbTalk3D's Table 1 with its ablation: every face model of conf/experiment/probtalk3d_table, three seeds.

Run     python -m pipelines.face_table [--out DIR] [overrides], e.g. seeds=0 for one seed of all, or experiment=tiny
Reads   conf/; corpus, fit and embedding of `make repro` are reused if they match
Writes  DIR (by default docs/): face_table.md, face_table.json, pictures/face-*.png (those of PICTURES)

An interrupted run resumes: every model, its samples and its row are kept in the result store.

Seeds are those of training and sampling; corpus, fit and stage 1 are shared. Models run in parallel, one per process.
Outside the default pipeline.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image

from pipelines.evaluate import InputPaths, held_out_sounds
from pipelines.evaluate_face import REAL_ROWS, FaceInputPaths, measure_faces, stack_faces
from pipelines.table_runs import (
    METRICS_FILE,
    RowResult,
    RowSpec,
    TableOptions,
    compute_rows,
    configs_by_seed,
    parse_arguments,
)
from talkingeyes.audio.annotation import EMOTIONS, INTENSITIES, Annotation
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.face.articulation import OPEN_VOWELS, ArticulationMetrics
from talkingeyes.evaluation.face.pictures import frame_sheet, heat_map_sheet
from talkingeyes.evaluation.face.summary import FaceMetrics, paired_differences, summarise_seeds
from talkingeyes.evaluation.face.surface import FaceSurface
from talkingeyes.evaluation.face.table import (
    ARTICULATION_COLUMNS,
    ERROR_COLUMNS,
    PAPER_COLUMNS,
    PUBLISHED,
    TITLES,
    face_markdown,
)
from talkingeyes.evaluation.face.vertices import VertexErrors
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.evaluation.paper_metrics.table3 import SPLIT_TITLES, markdown_table
from talkingeyes.head.anny import anny_head
from talkingeyes.models.face.style import NEUTRAL, FaceStyle, StyleKey
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import Report, Workspace, run_command
from talkingeyes.orchestration.stage_graph import StageCall
from talkingeyes.training.face_generators import TrainedFaceGenerator, load_face_generator

EXPERIMENT = "experiment=probtalk3d_table"
# Code that a row depends on besides its inputs.
ROW_CODE = (
    "pipelines/evaluate_face.py",
    "pipelines/face_table.py",
    "src/talkingeyes/evaluation/face",
    "src/talkingeyes/head",
)
HEAT_MAP_ROWS = ("truth", "probtalk3d", "face_vae", "face_ddim", "face_codetalker", "face_mean")
# The paper has FaceDiffuser and EMOTE, which is deterministic, beside its own two.
SYLLABLE_ROWS = ("truth", "probtalk3d", "face_vae", "face_ddpm", "face_faceformer")
ABLATION_ROWS = ("truth", "probtalk3d", "probtalk3d_no_emotion", "face_vae", "face_vae_no_emotion")
# Closed lips, a pout, an open mouth: phonemes of espeak-ng.
SYLLABLES = {"p": ("p",), "m": ("m",), "w": ("w",), "a": OPEN_VOWELS}
HEAT_PX, TILE_PX, FRAMES_SHOWN = 220, 120, 6
EMOTION_MODEL = "probtalk3d"  # the model of the sheet of emotions
COMPARED = "probtalk3d"  # the row that the others are compared with, sound by sound
DIFFERENCE = f"minus_{COMPARED}"
INTRODUCTION = """# The face: ProbTalk3D's Table 1

Written by `python -m pipelines.face_table` (`make face`) at revision {revision}; an interrupted run resumes. Models:
[face_models.md](face_models.md). Metrics and caveats: [face_measures.md](face_measures.md).

Means over the seeds {seeds}, ten samples per sound. Errors are on the vertices of the open head, in millimetres,
against the true motion (its first take). This page shows new speakers; [face_table.json](face_table.json) has both
splits and all metrics, with 95 % intervals over sounds and the range of the seeds. The last column has the paper's
values on 3DMEAD and FLAME, read as metres and square metres: compare the order of rows, not the values.

"""
SHOWN = {
    "mve",
    "lve",
    "fdd_signed",
    "mee",
    "ce",
    "diversity",
    "diversity_ratio",
    "bilabials_closed",
    "emotion_accuracy",
}
SHOWN_SPLIT = "unseen"
COMPARED_METRICS = {"mve", "lve", "diversity_ratio", "bilabials_closed", "emotion_accuracy"}
DIFFERENCES = """### Less ProbTalk3D, sound by sound

Differences of the rows above on the same sounds and seeds, with 95 % intervals over sounds; bold: without 0.

"""

PICTURES = {
    "face-syllables.png": "Syllables of one neutral sentence (as in Fig. 5 of the paper)",
    "face-heat.png": "Motion of each vertex from frame to frame (as in Fig. 6 of the paper)",
    "face-emotions-model.png": "One sentence in eight emotions (as in Fig. 7 of the paper)",
    "face-ablation.png": "With and without emotion control (as in Fig. 8 of the paper)",
}


def rows_of(params: Mapping[str, Any]) -> list[str]:
    """The models that generate the face alone."""
    return [name for name, model in params["model"].items() if tuple(model["parts"]) == ("face",)]


def main() -> None:
    """Compute all models with all seeds, then write the page and the pictures."""
    wanted = options(sys.argv[1:])
    out, made = wanted.out, configs_by_seed(wanted.overrides, wanted.seeds)
    params = made[0]
    kind = RowSpec("face_metrics", ROW_CODE, (), ("evaluate",), _measure, tuple(rows_of(params)), REAL_ROWS)
    found = compute_rows(made, kind, critic=False, title="face")
    settings = EvaluateSettings.model_validate(params["evaluate"])
    by_seed = {name: [_by_split(one) for one in seeds] for name, seeds in found.by_name.items()}
    table = {name: _summary(seeds, by_seed[COMPARED], settings) for name, seeds in by_seed.items()}
    (out / "pictures").mkdir(parents=True, exist_ok=True)
    _draw(out / "pictures", found.data, {name: seeds[0] for name, seeds in found.by_name.items()})
    (out / "face_table.json").write_text(json.dumps(table, indent=1))
    introduction = INTRODUCTION.format(revision=revision(), seeds=", ".join(map(str, wanted.seeds)))
    (out / "face_table.md").write_text(introduction + summary(table) + differences(table) + pictures(out / "pictures"))
    print(face_markdown(table))


def summary(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The table of new speakers, a few columns without intervals."""
    columns = [each for each in (*ERROR_COLUMNS, *ARTICULATION_COLUMNS) if each.metric in SHOWN]
    headings = ["", *(each.heading for each in columns), f"paper: {', '.join(PAPER_COLUMNS)}"]
    lines = []
    for name in (known for known in TITLES if SHOWN_SPLIT in rows.get(known, {})):
        found = rows[name][SHOWN_SPLIT]["face"]
        cells = [f"{found[each.metric]['value']:.{each.digits}f}" if found.get(each.metric) else "" for each in columns]
        paper = ", ".join("–" if value is None else f"{value:.4g}" for value in PUBLISHED.get(name, ()))
        lines.append([TITLES[name], *cells, paper])
    return markdown_table(headings, lines) + "\n\n"


def differences(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Each row less ProbTalk3D on new speakers, sound by sound, with intervals; bold: without 0."""
    columns = [each for each in (*ERROR_COLUMNS, *ARTICULATION_COLUMNS) if each.metric in COMPARED_METRICS]
    lines = []
    for name in (known for known in TITLES if DIFFERENCE in rows.get(known, {}).get(SHOWN_SPLIT, {})):
        found = rows[name][SHOWN_SPLIT][DIFFERENCE]
        lines.append([TITLES[name], *(_difference(found.get(each.metric), each.digits) for each in columns)])
    if not lines:
        return ""
    return DIFFERENCES + markdown_table(["", *(each.heading for each in columns)], lines) + "\n\n"


def pictures(folder: Path) -> str:
    """The pictures that are in a folder: those of models that were not trained are missing."""
    shown = ((name, title) for name, title in PICTURES.items() if (folder / name).exists())
    return "\n".join(f"### {title}\n\n![{title}](pictures/{name})\n" for name, title in shown)


def _difference(found: Mapping[str, float] | None, digits: int) -> str:
    if found is None:
        return ""
    value = f"{found['value']:+.{digits}f}"
    shown = f"**{value}**" if found["low"] > 0 or found["high"] < 0 else value
    return f"{shown} <sub>{found['low']:.{digits}f} to {found['high']:.{digits}f}</sub>"


def options(arguments: Sequence[str]) -> TableOptions:
    """The options; by default, all face models."""
    wanted = parse_arguments(arguments)
    if any(text.startswith("experiment=") for text in wanted.overrides):
        return wanted
    return replace(wanted, overrides=[EXPERIMENT, *wanted.overrides])


def _measure(call: StageCall, workspace: Workspace) -> Report:
    """Metrics of a row, sound by sound."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    places = (workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", row))
    sounds = [
        item.takes for item in held_out_sounds(InputPaths("fitted", *places, settings.benchmark_samples), settings)
    ]
    paths = FaceInputPaths(row, workspace.corpus, data("fit"), data("sample", row), settings.seed)
    figures = measure_faces(paths, sounds, workspace.jobs)
    found = [{"split": takes[0].split, **asdict(one)} for takes, one in zip(sounds, figures, strict=True)]
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps(found))
    return Report()


def _by_split(row: RowResult) -> dict[str, list[FaceMetrics]]:
    """Metrics of every sound of one seed of a row, by split."""
    found = json.loads(row.figures.read_text())
    return {split: [_figures(each) for each in found if each["split"] == split] for split in SPLIT_TITLES}


def _summary(
    seeds: Sequence[Mapping[str, list[FaceMetrics]]],
    compared: Sequence[Mapping[str, list[FaceMetrics]]],
    settings: EvaluateSettings,
) -> dict[str, Any]:
    """{split: {"face": metrics, DIFFERENCE: metrics less those of the compared row}} of a row over its seeds."""
    found: dict[str, Any] = {}
    for split in (each for each in SPLIT_TITLES if seeds[0][each]):
        here, other = ([each[split] for each in row] for row in (seeds, compared))
        summary = summarise_seeds(here, settings.bootstrap)
        found[split] = {"face": {name: asdict(estimate) for name, estimate in summary.items()}}
        if seeds is not compared:
            same = here if len(here) == len(other) else here[:1] * len(other)  # real motion has one seed
            difference = paired_differences(same, other, settings.bootstrap)
            found[split][DIFFERENCE] = {name: asdict(estimate) for name, estimate in difference.items()}
    return found


def _figures(row: Mapping[str, Any]) -> FaceMetrics:
    errors = VertexErrors(**row["errors"]) if row["errors"] else None
    rest = {name: row[name] for name in ("diversity", "diversity_truth", "emotion", "accuracy")}
    return FaceMetrics(errors=errors, articulation=ArticulationMetrics(**row["articulation"]), **rest)


def _draw(folder: Path, data: Mapping[str, Path], made: Mapping[str, RowResult]) -> None:
    """Pictures of the first seed, for sounds of test: a neutral one, and one of the strongest emotion (Fig. 8)."""
    corpus, surface = Corpus(data["synthesize"]), FaceSurface(anny_head())
    clips = sorted(corpus.select("test", take=0), key=lambda clip: (clip.intensity, clip.id))
    if not clips:
        return
    mildest = [clip for clip in clips if clip.intensity == clips[0].intensity]
    neutral = max(mildest, key=lambda clip: len(syllable_times_s(corpus.annotation(clip))))
    strongest = clips[-1]

    def rows(names: Sequence[str], clip: Clip) -> dict[str, FaceSamples]:
        shown = {"Truth": stack_faces([corpus.truth(clip)])}
        for name in names:
            samples = made[name].samples if name in made else None
            if samples is not None:
                shown[TITLES[name]] = FaceSamples.load(shard_path(samples, clip.id, ".npz"))
        return shown

    def save(name: str, picture: UInt8[ndarray, "H W 3"]) -> None:
        Image.fromarray(picture).save(folder / name)

    spoken = syllable_times_s(corpus.annotation(neutral))
    save("face-syllables.png", frame_sheet(surface.model, rows(SYLLABLE_ROWS, neutral), spoken, TILE_PX))
    save("face-heat.png", heat_map_sheet(surface, rows(HEAT_MAP_ROWS, neutral), HEAT_PX))
    emotional = spread_times_s(strongest, f"{strongest.emotion} {strongest.intensity}, ")
    save("face-ablation.png", frame_sheet(surface.model, rows(ABLATION_ROWS, strongest), emotional, TILE_PX))
    model = made[EMOTION_MODEL].model if EMOTION_MODEL in made else None
    if model is not None:
        by_emotion = sample_emotions(load_face_generator(model), data["embed"], neutral)
        save("face-emotions-model.png", frame_sheet(surface.model, by_emotion, spread_times_s(neutral), TILE_PX))


def spread_times_s(clip: Clip, caption: str = "") -> dict[str, float]:
    """Times at equal distances over a clip, by their captions."""
    times_s = [(at + 0.5) * clip.seconds / FRAMES_SHOWN for at in range(FRAMES_SHOWN)]
    return {f"{caption}{time_s:.1f} s": time_s for time_s in times_s}


def syllable_times_s(annotation: Annotation) -> dict[str, float]:
    """The middle of the first phoneme of each kind of SYLLABLES."""
    found = {}
    for title, kinds in SYLLABLES.items():
        same = (each for each in annotation.phonemes if each.symbol.startswith(kinds))
        if first := next(same, None):
            found[title] = (first.start_s + first.end_s) / 2
    return found


def sample_emotions(generator: TrainedFaceGenerator, embed: Path, clip: Clip) -> dict[str, FaceSamples]:
    """One sample of the same speech and speaker in every emotion at maximum intensity."""
    embedding = np.load(shard_path(embed / "speech", clip.sound, ".npy"))
    speaker = clip.speaker if clip.speaker in generator.vocabulary.speakers else None
    styles = {name: FaceStyle(speaker, name, 0 if name == NEUTRAL else max(INTENSITIES)) for name in EMOTIONS}
    return {name: generator.generate(embedding, [StyleKey(0.0, one)], [0], clip.fps) for name, one in styles.items()}


if __name__ == "__main__":
    run_command(
        importlib.import_module("pipelines.face_table").main
    )  # by module name, so that worker processes can import `_measure`
