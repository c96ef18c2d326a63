"""Measure the packaged models on a sealed corpus, and append the figures to docs/results/releases.md.

Run     make release-report        (python -m pipelines.results.release_report), after make report
Reads   the packaged models; of the default chain in data/: baselines, critics, and real motion of the train split, to
        which hazards of gaze aversion and the classifier of emotions are fitted
Writes  build/sealed/N: a corpus of 300 sounds of 50 people; build/sealed/N-remote_call: the same sounds, with the gaze
        of people in remote calls; docs/results/releases.md

Every other stage refuses these corpora (`Workspace.corpus`), and each report has a corpus that no report before it
read, so that nothing is chosen by its figures.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import date
from functools import partial
from itertools import compress
from pathlib import Path

import numpy as np

from pipelines import embed, evaluate, fit, sample, synthesize
from pipelines.evaluate_face import measure_faces
from pipelines.report import aversion_table
from talkingeyes.animation.model_file import (
    PACKAGED_LIVE_MODEL,
    PACKAGED_MODEL,
    PACKAGED_MODELS,
    PACKAGED_REMOTE_CALL_MODEL,
    find_face_model,
    open_model,
)
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.sound_groups import SoundGroup, group_sounds
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.benchmark.paired import motion_behaviours, sample_behaviours
from talkingeyes.evaluation.benchmark.table import from_json
from talkingeyes.evaluation.benchmark.table import markdown as benchmark_markdown
from talkingeyes.evaluation.bootstrap import Estimate, bootstrap, mean_statistic
from talkingeyes.evaluation.measures.corr import TITLES as CORR_TITLES
from talkingeyes.evaluation.measures.evaluators import Evaluators
from talkingeyes.evaluation.measures.partner_gaze import CURVES
from talkingeyes.evaluation.papers.probtalk3d_metrics import summarise_face
from talkingeyes.evaluation.papers.table3 import TITLES
from talkingeyes.evaluation.report.information import SoundAversion, aversion_information, sound_aversion
from talkingeyes.evaluation.report.requirements import LOOKUPS, model_requirements, model_requirements_table
from talkingeyes.evaluation.report.validation_metrics import ValidateSettings
from talkingeyes.evaluation.text_tables import Column, markdown_table
from talkingeyes.orchestration.config import compose, write_params
from talkingeyes.orchestration.mlflow_logging import revision
from talkingeyes.orchestration.run import SEAL, Workspace, parallel_map, run_command

CHAIN, SEALED, PAGE = Path("data"), Path("build/sealed"), Path("docs/results/releases.md")
REFERENCES = ("truth", "fitted", "mismatched")
BASELINES = ("random", "similar", *LOOKUPS, "untrained")
DEFAULT = "talkingeyes_events"
MODELS = {DEFAULT: PACKAGED_MODEL, "talkingeyes_live": PACKAGED_LIVE_MODEL}
FACE_COLUMNS = (
    Column("emotion recognised", "emotion_accuracy", 2),
    Column("lips closed", "bilabials_closed", 2),
    Column("LVE mm", "lve", 2),
)
SPLIT = "unseen"
CORR_PARTS = ("head", "gaze_in_space")


def run() -> None:
    """Make the corpus if it is not there, measure every row, and append a section."""
    for name in BASELINES:
        if not (CHAIN / "train" / name).is_dir():
            raise InputError(f"{CHAIN}/train: should hold {name}, got none; `make report` makes it")
    baselines = {name: CHAIN / "train" / name for name in BASELINES}
    with ExitStack() as stack:
        models = {name: stack.enter_context(open_model(path)) for name, path in MODELS.items()}
        face = find_face_model(models[DEFAULT])
        assert face is not None
        workspace = _sealed_workspace()
        measured = _measure(workspace, baselines | models, face)
        of_calls = {
            "untrained": baselines["untrained"],
            PACKAGED_REMOTE_CALL_MODEL.stem: stack.enter_context(open_model(PACKAGED_REMOTE_CALL_MODEL)),
        }
        measured_calls = _measure(_sealed_workspace("remote_call"), of_calls)
    languages, faces = _language_table(workspace), _face_table(workspace, Workspace.open(Path.cwd()), face.name)
    section = _section(workspace.corpus, measured, languages, faces, measured_calls)
    with atomic_write(PAGE) as path:
        path.write_text(PAGE.read_text() + section)
    print(section)


@dataclass(frozen=True)
class Measured:
    """Tables of one sealed corpus, a column for each row of REFERENCES, baselines and models."""

    aversion: str
    timing: str
    requirements: str


def _measure(workspace: Workspace, models: Mapping[str, Path], face: Path | None = None) -> Measured:
    """Sample and evaluate models (their folders, by name) beside the references; `face` is sampled alone."""
    for name, folder in (*models.items(), *([(face.name, face)] if face else [])):
        _link(workspace.data("train", name), folder)
    for name in (*models, *([face.name] if face else [])):
        sample.run(workspace, name)
    names = (*REFERENCES, *models)
    for name in names:
        evaluate.run(workspace, name, training=Workspace.open(Path.cwd()))
    rows, stored, aversions = (
        {name: json.loads(workspace.data("evaluate", name, file).read_text()) for name in names}
        for file in ("metrics.json", "benchmark.json", "aversion.json")
    )
    benchmarks = {name: from_json(each) for name, each in stored.items()}
    required = {
        name: [
            each for each in model_requirements(rows, benchmarks, aversions, name) if not each.name.startswith("test:")
        ]
        for name in names
    }
    timing = {name: [each for each in found if each.metric.extractor is CURVES] for name, found in benchmarks.items()}
    return Measured(aversion_table(aversions), benchmark_markdown(timing, TITLES), model_requirements_table(required))


def _sealed_workspace(population: str | None = None) -> Workspace:
    """The sealed corpus with its fitted motion and features, and the critics of the chain. All of it is unseen.

    `population`: that of its gaze; by default the chain's.
    """
    number = PAGE.read_text().count("\n## ")  # of reports before this one
    params = compose(["experiment=sealed"])
    params["synthesize"]["seed"] += number
    if population is not None:
        params["synthesize"]["population"] = population
    workspace = Workspace(SEALED / (f"{number}-{population}" if population else str(number)), params)
    corpus = Corpus(workspace.data("synthesize"))
    seal = corpus.root / SEAL
    if not seal.exists():
        for stage in (synthesize, fit, embed):
            stage.run(workspace)
        corpus.write_index([replace(clip, split=SPLIT) for clip in corpus.clips])
        seal.touch()
        write_params(workspace.root / "params.yaml", params)
    _link(workspace.data("critic"), CHAIN / "critic")
    return replace(workspace, may_read_sealed=True)


def _link(place: Path, target: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.unlink(missing_ok=True)
    place.symlink_to(target.resolve())


def _sounds(workspace: Workspace) -> list[SoundGroup]:
    seed = workspace.settings("validate", ValidateSettings).seed
    return group_sounds(Corpus(workspace.corpus), workspace.data("fit"), workspace.data("embed"), (SPLIT,), 1, seed)


def _language_table(workspace: Workspace) -> str:
    """The default model by language: Corr. under the own sound less that under other sounds, and what the sounds tell
    about averted gaze, beside what they tell about that of the truth."""
    settings = workspace.settings("validate", ValidateSettings)
    corpus = Corpus(workspace.corpus)
    name, sounds = DEFAULT, _sounds(workspace)
    paths = workspace.input_paths(name)
    measure = partial(evaluate.evaluate_sound, paths, Evaluators.load(paths.critic))
    evaluated = [each for each in parallel_map(measure, sounds, workspace.jobs, "languages") if each is not None]
    assert len(evaluated) == len(sounds), "a model has motion for every sound"
    languages = [sound.clip.language for sound in sounds]
    generated, true = list[SoundAversion](), list[SoundAversion]()
    for sound, each in zip(sounds, evaluated, strict=True):
        annotation = corpus.annotation(sound.clip)
        generated.append(sound_aversion(sound.clip.speaker, sample_behaviours(each.samples, annotation)))
        true.append(sound_aversion(sound.clip.speaker, motion_behaviours([corpus.truth(sound.clip)], annotation)))
    lines = []
    for language in sorted(set(languages)):
        own = [each == language for each in languages]
        others = [not each for each in own]
        found = [each.figures for each in compress(evaluated, own)]
        advantages = [np.array([each[part].corr - each[part].corr_shuffled for each in found]) for part in CORR_PARTS]
        ties = [bootstrap(mean_statistic(each), len(each), settings.bootstrap) for each in advantages]
        cells = ["{value:.2f} ({low:.2f} to {high:.2f})".format(**asdict(each)) for each in ties]
        cells += [
            "{value:.3f} ({low:.3f} to {high:.3f})".format(
                **asdict(aversion_information([*compress(row, own)], settings.bootstrap, [*compress(row, others)]))
            )
            for row in (generated, true)
        ]
        lines.append([language, str(sum(own)), *cells])
    columns = [CORR_TITLES[part] for part in CORR_PARTS]
    return markdown_table(["", "sounds", *columns, "information, model", "information, truth"], lines)


def _face_table(workspace: Workspace, training: Workspace, name: str) -> str:
    """The packaged face by language, each value beside that of fitted motion."""
    settings = workspace.settings("validate", ValidateSettings)
    sounds = [group.takes for group in _sounds(workspace)]
    languages = [takes[0].language for takes in sounds]
    measured = {}
    for row in (name, "fitted"):
        paths, of_training = workspace.input_paths(row), training.input_paths(row)
        measured[row] = measure_faces(paths, sounds, workspace.jobs, settings.seed, of_training)
    lines = []
    for language in sorted(set(languages)):
        found = {
            row: summarise_face(
                [one for one, spoken in zip(ones, languages, strict=True) if spoken == language], settings.bootstrap
            )
            for row, ones in measured.items()
        }
        cells = [_face_cell(found[name][each.metric], found["fitted"][each.metric], each) for each in FACE_COLUMNS]
        lines.append([language, str(languages.count(language)), *cells])
    return markdown_table(["", "sounds", *(column.heading for column in FACE_COLUMNS)], lines)


def _face_cell(model: Estimate, fitted: Estimate, column: Column) -> str:
    value, low, high, target = (
        f"{each:.{column.digits}f}" for each in (model.value, model.low, model.high, fitted.value)
    )
    return f"{value} ({low} to {high}) / {target}"


def _section(corpus: Path, measured: Measured, languages: str, faces: str, calls: Measured) -> str:
    files = "\n".join(
        f"- `{path.name}`: sha256 `{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}`"
        for path in PACKAGED_MODELS.values()
    )
    index = hashlib.sha256((corpus / "clips.parquet").read_bytes()).hexdigest()[:16]
    return f"""
## {date.today().isoformat()}, revision {revision()}

Packaged files, trained by `make release-models`, as they are (half precision); critics and baselines of `make report`:

{files}

Sealed corpus: sha256 of its index `{index}`.

### Information of speech about averted gaze, nats per second

{measured.aversion}

### Averted gaze around events of speech

Each value with its interval over sounds; bold: worse than the truth for the same sounds by more than the interval.

{measured.timing}

### `{DEFAULT}` by language

Corr. under a sound's own samples less that under other sounds of the speaker; information of speech about averted gaze,
nats per second, by a regression fitted to all languages.

{languages}

### The face by language

Packaged model / fitted motion; emotions are classified as in the English chain. Chance of an emotion is 0.125; in
docs/results/face_table.md, another corpus, faces of other clips close 0.35 to 0.38 of the lips.

{faces}

### Requirements

{measured.requirements}

### Remote calls: information of speech about averted gaze

The same sounds with gaze of the population `remote_call`.

{calls.aversion}

### Remote calls: averted gaze around events of speech

{calls.timing}

### Remote calls: requirements

{calls.requirements}
"""


if __name__ == "__main__":
    run_command(run)
