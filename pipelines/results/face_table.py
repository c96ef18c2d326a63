"""ProbTalk3D's Table 1 with its ablation: every face model of conf/experiment/probtalk3d_table, three seeds.

Run     python -m pipelines.results.face_table [models=face_vae,probtalk3d] [seeds=0,1,2] [--out DIR] [overrides]
Reads   conf/; corpus, fit and embedding of `make repro` are reused if they match
Writes  DIR (by default docs/): face_rows/ROW-SEED.json, then face_table.md and face_table.json of all files in
        face_rows, and pictures/face-*.png (those of PICTURES whose rows are all among `models`)

Rows and seeds can be computed at different times and on different machines (face_rows.py). An interrupted run resumes:
every model, its samples and its row are kept in the result store.

Seeds are those of training and sampling; corpus, fit and stage 1 are shared. Models run in parallel, one per process.
Outside the default pipeline.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image

from pipelines.evaluate_face import REAL_ROWS, stack_faces
from pipelines.results.face_rows import FOLDER, ROW_CODE, FaceRow, measure, measured_row, read_rows, write_row
from pipelines.results.table_runs import (
    RowResult,
    RowSpec,
    TableOptions,
    compute_rows,
    configs_by_seed,
    configuration_hash,
    parse_arguments,
)
from talkingeyes.audio.annotation import EMOTIONS, INTENSITIES, Annotation
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.papers.probtalk3d_articulation import OPEN_VOWELS
from talkingeyes.evaluation.papers.probtalk3d_metrics import paired_differences, summarise_seeds
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.evaluation.papers.probtalk3d_table import (
    ARTICULATION_COLUMNS,
    ERROR_COLUMNS,
    PAPER_COLUMNS,
    PUBLISHED,
    TITLES,
    face_markdown,
    frame_sheet,
    heat_map_sheet,
)
from talkingeyes.evaluation.papers.table3 import SPLIT_TITLES
from talkingeyes.evaluation.papers.talkingeyes_metrics import EvaluateSettings
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.head.anny import anny_head
from talkingeyes.models.face.style import NEUTRAL, FaceStyle, StyleKey
from talkingeyes.orchestration.run import run_command
from talkingeyes.training.face_generators import TrainedFaceGenerator, load_face_generator

Picture = UInt8[ndarray, "H W 3"]
EXPERIMENT = "experiment=probtalk3d_table"
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
# Sections of the composition that every row depends on; models and stage 1 are added by name.
SECTIONS = ("corpus", "synthesize", "fit", "embed", "sample", "evaluate")
INTRODUCTION = """# The face: ProbTalk3D's Table 1

Written by `python -m pipelines.results.face_table` (`make face`) from the rows in docs/results/face_rows, at revision
{revisions}. Models: [face_models.md](../face_models.md). Metrics and caveats: [face_measures.md](../face_measures.md).

Means over the seeds {seeds}, ten samples per sound, new speakers. Errors are on the vertices of the open head, in
millimetres, against the true motion (its first take). [face_table.json](face_table.json) has both splits and all
metrics, with 95 % intervals over sounds and the range of the seeds. Stage 2 has equal steps of 8 windows; VAE and codes
have a stage 1 besides (diffusion with as many steps in all: [results](../face_models.md#results)). Codes over time have
four times the steps of both stages, one clip each. The last column has the paper's values on 3DMEAD and FLAME, read
as metres and square metres: compare the order of rows, not the values.

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

LEARNING = "learning"
LEARNING_TEXT = """### Energy score on val while learning

Lower is better; bold: the weights that are kept. A row whose last score is its lowest was still learning. Faces are
sampled at the temperature of the last column, a factor on the noise of the VAE
([log](../log/2026-11-28-face-temperature-rule.md)).

"""

PICTURES = {
    "face-syllables.png": "Syllables of one neutral sentence (as in Fig. 5 of the paper)",
    "face-heat.png": "Motion of each vertex from frame to frame (as in Fig. 6 of the paper)",
    "face-emotions-model.png": "One sentence in eight emotions (as in Fig. 7 of the paper)",
    "face-ablation.png": "With and without emotion control (as in Fig. 8 of the paper)",
}


def main() -> None:
    """Compute the chosen models with all seeds, one file each, then write the page of all files and the pictures."""
    wanted = options(sys.argv[1:])
    out, made = wanted.out, configs_by_seed(wanted.overrides, wanted.seeds)
    params, configurations = made[0], configuration_hashes(wanted.overrides)
    unknown = [name for name in wanted.words["models"] if name not in configurations]
    if unknown:
        raise InputError(f"models: should be among {', '.join(rows_of(params))}; got {unknown[0]!r}")
    read_rows(out / FOLDER, configurations)
    models = tuple(wanted.words["models"] or rows_of(params))
    kind = RowSpec("face_metrics", ROW_CODE, (), ("evaluate",), measure, models, REAL_ROWS)
    found = compute_rows(made, kind, critic=False, title="face")
    measured = [
        measured_row(one, seed, configurations[name])
        for name, by_seed in found.by_name.items()
        for seed, one in zip(wanted.seeds, by_seed, strict=False)  # real motion has one seed
    ]
    for row in measured:  # after all have read the revision, which the first file makes a changed one
        write_row(out / FOLDER, row)
    rows = read_rows(out / FOLDER, configurations)
    table = summarise(rows, EvaluateSettings.model_validate(params["evaluate"]).bootstrap)
    (out / "pictures").mkdir(parents=True, exist_ok=True)
    _draw(out / "pictures", found.data, {name: by_seed[0] for name, by_seed in found.by_name.items()})
    (out / "face_table.json").write_text(json.dumps(table, indent=1))
    (out / "face_table.md").write_text(document(table, rows) + pictures(out / "pictures"))
    print(face_markdown(table))


def rows_of(params: Mapping[str, Any]) -> list[str]:
    """The models that generate the face alone."""
    return [name for name, model in params["model"].items() if tuple(model["parts"]) == ("face",)]


def configuration_hashes(overrides: Sequence[str]) -> dict[str, str]:
    """Hash of all settings that each row depends on, but for the seeds."""
    (params,) = configs_by_seed(overrides, [0])
    of_models = {name: configuration_hash(params, SECTIONS, [name]) for name in rows_of(params)}
    return of_models | {name: configuration_hash(params, SECTIONS, ()) for name in REAL_ROWS}


def summarise(rows: Mapping[str, Sequence[FaceRow]], settings: BootstrapSettings) -> dict[str, Any]:
    """{row: {split: {"face": metrics, DIFFERENCE: metrics less those of the compared row}, LEARNING: ...}}."""
    compared = rows.get(COMPARED, ())
    table: dict[str, Any] = {name: _summary(seeds, compared, settings) for name, seeds in rows.items()}
    for name, seeds in rows.items():
        if seeds[0].scores:
            table[name][LEARNING] = _learning(seeds)
    return table


def document(table: Mapping[str, Mapping[str, Any]], rows: Mapping[str, Sequence[FaceRow]]) -> str:
    """The page without its pictures."""
    every = [each for seeds in rows.values() for each in seeds]
    seeds = sorted({each.seed for each in every})
    fewer = [TITLES[name] for name in TITLES if name in rows and name not in REAL_ROWS and len(rows[name]) < len(seeds)]
    missing = [TITLES[name] for name in TITLES if name not in rows]
    introduction = INTRODUCTION.format(
        revisions=", ".join(sorted({each.revision for each in every})), seeds=", ".join(map(str, seeds))
    )
    notes = [("Not computed yet", missing), ("With fewer seeds", fewer)]
    said = "".join(f"{title}: {'; '.join(names)}.\n\n" for title, names in notes if names)
    return introduction + said + summary(table) + differences(table) + learning(table)


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


def learning(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Scores on val of the networks while they learnt, and their temperatures."""
    learnt = {name: rows[name][LEARNING] for name in TITLES if LEARNING in rows.get(name, {})}
    if not learnt:
        return ""
    steps = sorted({step for each in learnt.values() for step in each["scores"]}, key=int)
    lines = []
    for name, each in learnt.items():
        lowest = min(each["scores"].values())
        cells = [_score(each["scores"].get(step), lowest) for step in steps]
        lines.append([TITLES[name], *cells, f"{each['temperature']:g}" if each["temperature"] else ""])
    return LEARNING_TEXT + markdown_table(["", *(f"{step} steps" for step in steps), "temperature"], lines) + "\n\n"


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


def _score(score: float | None, lowest: float) -> str:
    if score is None:
        return ""
    return f"**{score:.2f}**" if score == lowest else f"{score:.2f}"


def options(arguments: Sequence[str]) -> TableOptions:
    """The options: models=..., and those of table_runs.py."""
    wanted = parse_arguments(arguments, ["models"])
    if any(text.startswith("experiment=") for text in wanted.overrides):
        return wanted
    return replace(wanted, overrides=[EXPERIMENT, *wanted.overrides])


def _summary(
    seeds: Sequence[FaceRow], compared: Sequence[FaceRow], settings: BootstrapSettings
) -> dict[str, dict[str, Any]]:
    """{split: {"face": metrics, DIFFERENCE: metrics less those of the compared row, of the seeds that both have}}."""
    by_seed = {each.seed: each for each in seeds}
    if seeds[0].row in REAL_ROWS:  # one seed, compared with all
        by_seed = {each.seed: seeds[0] for each in compared}
    found: dict[str, Any] = {}
    for split in (each for each in SPLIT_TITLES if seeds[0].sounds.get(each)):
        face = summarise_seeds([each.sounds[split] for each in seeds], settings)
        found[split] = {"face": {name: asdict(estimate) for name, estimate in face.items()}}
        both = [(by_seed[each.seed].sounds[split], each.sounds[split]) for each in compared if each.seed in by_seed]
        if both and seeds[0].row != COMPARED:
            here, other = ([pair[side] for pair in both] for side in (0, 1))
            difference = paired_differences(here, other, settings)
            found[split][DIFFERENCE] = {name: asdict(estimate) for name, estimate in difference.items()}
    return found


def _learning(seeds: Sequence[FaceRow]) -> dict[str, Any]:
    """{"scores": {step: mean over seeds}, "temperature": that of all seeds}."""
    return {
        "scores": {step: float(np.mean([each.scores[step] for each in seeds])) for step in seeds[0].scores},
        "temperature": seeds[0].temperature,
    }


def _draw(folder: Path, data: Mapping[str, Path], made: Mapping[str, RowResult]) -> None:
    """Pictures of the first seed, for sounds of test: a neutral one, and one of the strongest emotion (Fig. 8)."""
    corpus, surface = Corpus(data["synthesize"]), FaceSurface(anny_head())
    clips = sorted(corpus.select("test", take=0), key=lambda clip: (clip.intensity, clip.id))
    if not clips:
        return
    mildest = [clip for clip in clips if clip.intensity == clips[0].intensity]
    neutral = max(mildest, key=lambda clip: len(syllable_times_s(corpus.annotation(clip))))
    strongest = clips[-1]

    def save(name: str, rows: Sequence[str], clip: Clip, draw: Callable[[dict[str, FaceSamples]], Picture]) -> None:
        paths = {row: made[row].samples for row in rows if row in made}
        if set(rows) - set(paths) - set(REAL_ROWS):
            return
        shown = {"Truth": stack_faces([corpus.truth(clip)])}
        for row, samples in paths.items():
            if samples is not None:
                shown[TITLES[row]] = FaceSamples.load(shard_path(samples, clip.id, ".npz"))
        Image.fromarray(draw(shown)).save(folder / name)

    def frames(times_s: Mapping[str, float]) -> Callable[[dict[str, FaceSamples]], Picture]:
        return lambda shown: frame_sheet(surface.model, shown, times_s, TILE_PX)

    emotional = spread_times_s(strongest, f"{strongest.emotion} {strongest.intensity}, ")
    save("face-syllables.png", SYLLABLE_ROWS, neutral, frames(syllable_times_s(corpus.annotation(neutral))))
    save("face-heat.png", HEAT_MAP_ROWS, neutral, lambda shown: heat_map_sheet(surface, shown, HEAT_PX))
    save("face-ablation.png", ABLATION_ROWS, strongest, frames(emotional))
    model = made[EMOTION_MODEL].model if EMOTION_MODEL in made else None
    if model is not None:
        by_emotion = sample_emotions(load_face_generator(model), data["embed"], neutral)
        Image.fromarray(frames(spread_times_s(neutral))(by_emotion)).save(folder / "face-emotions-model.png")


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
    run_command(main)
