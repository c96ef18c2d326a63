"""Stage `report`: Table III beside the paper's values, requirements and whether they are met, and plots.

Reads   data/evaluate/* (metrics, speeds, the gaze benchmark), data/information/*, data/critic/report.json and
        notes.txt; for plots and films the corpus, data/fit and data/sample/*; if they exist, data/fit/table8.json,
        data/pretrain/*/codes.json and data/validate/*
Writes  data/report/: metrics.json {row: {split: {part: {metric: value}}}}, table3.md, table3.csv, and as PNG: metrics,
        traces (several samples of one sound), speeds, code usage, benchmark (all metrics beside the truth's
        intervals); face.md: the faces, as in ProbTalk3D's Table 1;
        requirements.json: margins and ties of every row, with intervals and whether they are met;
        summary.txt: five figures per model, which `make report` prints; rows/<row>.json: the same for `dvc metrics`;
        films/<row>.mp4: three seconds of every row, under the same sound
Run     python -m pipelines.report
"""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, shard_path
from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.benchmark.metric_class import count_learnt
from talkingeyes.evaluation.benchmark.table import from_json
from talkingeyes.evaluation.benchmark.table import markdown as benchmark_markdown
from talkingeyes.evaluation.papers.probtalk3d_table import face_markdown
from talkingeyes.evaluation.papers.table3 import TITLES, MethodMetrics, critic_table, markdown, order_rows, to_csv
from talkingeyes.evaluation.report.information import LIVE_LOOKAHEAD_S, information_table
from talkingeyes.evaluation.report.requirements import (
    TIED_PARTS,
    Requirement,
    count_by_kind,
    critic_requirements,
    face_requirements,
    model_requirements,
    model_requirements_table,
    report_summary,
    requirements_table,
    row_metrics,
    to_json,
)
from talkingeyes.evaluation.text_tables import markdown_table, training_budget, training_sentence
from talkingeyes.orchestration.run import MethodResult, Report, Workspace, main

# Methods whose traces are plotted beside the truth, and their number of samples.
TRACE_METHODS, SAMPLES_DRAWN = ("talkingeyes_events", "talkingeyes", "talkingeyes_paper", "vae"), 4
# Requirements on the stages before the models: pupil error and speed after fitting, fraction of used codes.
MAX_ERROR_PX, MIN_SPEED_RATIO, MAX_SPEED_RATIO, MIN_CODE_USAGE = 0.95, 1.0, 1.25, 0.9

INTRODUCTION = """# Table III

Each value is followed by its interval over speakers; table3.csv has that over clips, too. L2, Diversity and Corr.
compare with fitted motion, speeds with the true motion. The mean pose wins every L2 and a conditional mean wins Corr.:
compare both with truth, fitted and mismatched motion. The paper's values are of another corpus and another critic.
`TalkingEyes`, its row with events and `Untrained` are conditioned on the speaker; for unseen speakers, a random
training speaker is used for each sound.
All other models are unconditional.
"""
INFORMATION = """### Information that speech gives about motion

In nats per second, with intervals over speakers: log-likelihood of fitted motion less that under the same model trained
without speech. Head given speech, gaze given speech and head; total: both. Above 0: what was learnt from speech holds
for sounds that were not trained on. It says something only beside the last column: two untrained networks differ by
chance, as much under another sound of the speaker. Random and other rows without a likelihood have no line.
"""
AVERSION = f"""### Information of speech about averted gaze

In nats per second, with intervals over speakers, on test and unseen together. True aversions: how much more likely the
true changes of gaze are given the row's motions for the same sound (how many of them are averted) than without; motion
that knows nothing of the sound has none. Information: what events of speech (onsets, offsets, turns, hesitations,
fillers) tell about when gaze of the row itself leaves the partner and returns. A rule that locks gaze to onsets has
more of it than people, and gaze that hardly changes has much; read it beside the same gaze shifted by a random lag, and
with the changes. 0: none; below 0: what the regression overfits. At most {LIVE_LOOKAHEAD_S:g} s ahead: the most that
the live model can follow.
"""
EMOTION = """### Emotion in head and gaze

Fraction of motions whose emotion a classifier recognises from head and gaze alone, mean over emotions, with intervals
over speakers, on test and unseen together. It is trained on real motion of the train split. Random has no emotion;
motion that follows its sound has that of the voice.
"""
VALIDATION = """### On val, where models and settings are chosen

Distances of the distributions of eye speed, saccade amplitude and eccentricity from those of the truth, as multiples of
the distance of another true take of the same sounds (in standard deviations where no sound has one); ties: Corr. less
that under other sounds. Random and Mismatched have small distances: choose by distances and ties.
"""
VALIDATION_DISTANCES = ("eye_speed_distance", "saccade_amplitude_distance", "eccentricity_distance")
VALIDATION_TIES = ("tie", "tie_gaze_in_space", "tie_head")
REQUIREMENTS = """### What a model must reach

Margins (motion is like motion, whatever the sound) and ties (it follows its sound); bold: missed. Random and Mismatched
have the margins without a tie, a conditional mean ties without margins. Motion looked up in the training data by
loudness can have both: learnt is what lies beyond the better lookup, with the whole interval. Gaze at rest is
compared with fitted motion, the training target; true gaze trembles between saccades and rests less. Ratios of averted
gaze are of test and unseen together. Bounds are choices of this project, set when figures of an earlier run on test and
unseen were known. The bound of ties rose from 0.5 to 0.6 when Similar Sample came near it with more training sounds.
"""
FACE_MODEL = "probtalk3d"  # the face of `animate`
FACES = """# The face

Errors on the vertices of the open head, against the true motion; each value with its interval over sounds. Definitions
are in docs/face_measures.md, more rows in docs/results/face_table.md.

"""
BENCHMARK = """### The gaze benchmark, test and unseen together

Each value with its interval over sounds; bold: worse than the truth for the same sounds by more than the interval.
`fitted` is the training target, an upper bound. Definitions, caveats and classes of the metrics: docs/benchmark.md.
"""


@dataclass(frozen=True)
class Results:
    """What earlier stages wrote, by row; `counts` are those of codes, by tokenizer.

    `eyes` are the rows of more than a face.
    """

    rows: dict[str, MethodMetrics]
    eyes: dict[str, MethodMetrics]
    benchmarks: dict[str, list[MetricResult]]
    informed: dict[str, Any]
    aversions: dict[str, Any]
    emotions: dict[str, Any]
    on_val: dict[str, dict[str, float]]
    counts: dict[str, Float[ndarray, " K"]]
    critic: dict[str, Any]
    critic_notes: str
    required: dict[str, list[Requirement]]
    upstream: list[Requirement]
    budgets: dict[str, str]

    @classmethod
    def read(cls, workspace: Workspace, names: Collection[str] = ()) -> Results:
        """Of some rows, or of all that there are. Raises InputError if `evaluate` has none or a file is not
        readable."""
        rows = _json_of_rows(workspace.data("evaluate"), "metrics.json")
        rows = {name: row for name, row in rows.items() if not names or name in names}
        if not rows:
            raise InputError(f"{workspace.data('evaluate')}: should contain rows of `evaluate`, got none")
        eyes = {name: row for name, row in rows.items() if any(set(parts) - {"face"} for parts in row.values())}
        benchmarks = _benchmarks(workspace.data("evaluate"), order_rows(eyes))
        informed = _json_of_rows(workspace.data("information"), "metrics.json")
        informed = {name: informed[name] for name in order_rows(eyes) if name in informed}
        aversions = _json_of_rows(workspace.data("evaluate"), "aversion.json")
        on_val = _json_of_rows(workspace.data("validate"), "metrics.json")
        codes = _json_of_rows(workspace.data("pretrain"), "codes.json")
        counts = {name: np.array(found["counts"], float) for name, found in codes.items()}
        return cls(
            rows=rows,
            eyes=eyes,
            benchmarks=benchmarks,
            informed=informed,
            aversions=aversions,
            emotions=_json_of_rows(workspace.data("evaluate"), "emotion.json"),
            on_val={name: found for name, found in on_val.items() if found},
            counts=counts,
            critic=_json(workspace.data("critic", "report.json")),
            critic_notes=workspace.data("critic", "notes.txt").read_text(),
            required={name: model_requirements(eyes, benchmarks, aversions, name) for name in order_rows(eyes)},
            upstream=[
                *critic_requirements(eyes),
                *_upstream(workspace.data("fit", "table8.json"), counts),
                *face_requirements(rows, FACE_MODEL),
            ],
            budgets={
                name: training_budget(workspace.params.get("model", {}).get(name, {})) for name in order_rows(eyes)
            },
        )

    def table3(self) -> list[str]:
        """Table III as Markdown, with what its rows were trained with."""
        return [
            training_sentence({TITLES.get(name, name): budget for name, budget in self.budgets.items()}),
            "",
            markdown(self.eyes),
        ]


def run(workspace: Workspace) -> Report:
    """Collect the rows, write the tables and draw the plots."""
    results = Results.read(workspace)
    with workspace.output("report") as folder:
        _write_tables(folder, results)
        _draw(folder, workspace, results)
    artifacts = [path for path in sorted(workspace.data("report").iterdir()) if path.suffix]
    pictures = [path for path in artifacts if path.suffix in (".png", ".md")]
    return Report(
        metrics={
            f"requirements_missed/{name}": float(sum(not each.is_met for each in required))
            for name, required in results.required.items()
        },
        artifacts=artifacts,
        rows=[
            MethodResult(
                name, flat_metrics(name, results), [*pictures, *workspace.data("report", "films").glob(f"{name}.mp4")]
            )
            for name in order_rows(results.rows)
        ],
    )


def _write_tables(folder: Path, results: Results) -> None:
    """The page of Table III and that of the face; the same figures as CSV and JSON, and row by row; the summary."""
    (folder / "metrics.json").write_text(json.dumps(_values(results.rows), indent=1))
    (folder / "requirements.json").write_text(json.dumps(to_json(results.required), indent=1))
    (folder / "table3.csv").write_text(to_csv(results.eyes))
    (folder / "table3.md").write_text(_page(results))
    (folder / "face.md").write_text(FACES + face_markdown(results.rows))
    tied = {name: row for name, row in results.informed.items() if _uses_sound(row)}
    summary = report_summary(
        results.rows, tied, results.aversions, results.required, results.budgets, results.upstream, "data/report"
    )
    (folder / "summary.txt").write_text(summary)
    (folder / "rows").mkdir()
    for name, row in results.rows.items():
        figures = row_metrics(row, tied.get(name), results.aversions.get(name), results.required.get(name, ()))
        (folder / "rows" / f"{name}.json").write_text(json.dumps(figures, indent=1) + "\n")


def _draw(folder: Path, workspace: Workspace, results: Results) -> None:
    """Plots of the tables, and of motions of the sound with the most takes; its films."""
    # Imported here, because pipelines.summary uses this module and draws nothing.
    from pipelines.report_films import write_films
    from talkingeyes.evaluation.report import plots

    titled = {TITLES.get(name, name): table for name, table in results.benchmarks.items()}
    colours = {TITLES.get(name, name): colour for name, colour in plots.COLOURS.items()}
    plots.plot_strips(titled, colours, folder / "benchmark.png")
    plots.plot_metrics(results.eyes, folder / "metrics.png")
    plots.plot_speed_distributions(_speeds(workspace.data("evaluate"), order_rows(results.eyes)), folder / "speeds.png")
    if results.counts:
        plots.plot_code_usage(results.counts, folder / "code_usage.png")
    takes = _most_takes(Corpus(workspace.corpus))
    if takes:
        _draw_traces(workspace, takes, folder / "traces.png")
        write_films(workspace, list(results.rows), takes[0], folder / "films")


def _page(results: Results) -> str:
    parts = [INTRODUCTION]
    if results.informed:
        parts += [INFORMATION, information_table(results.informed, TITLES), ""]
    parts += [AVERSION, aversion_table(results.aversions), ""]
    if results.emotions:
        parts += [EMOTION, emotion_table(results.emotions), ""]
    if results.on_val:
        parts += [VALIDATION, validation_table(results.on_val), ""]
    parts += [REQUIREMENTS, model_requirements_table(results.required), "", *results.table3(), BENCHMARK]
    parts += [
        learnt_counts(results.benchmarks),
        benchmark_markdown(results.benchmarks, TITLES),
        "\n### Requirements on fitting, codebooks, critics and the face\n",
        requirements_table(results.upstream),
        "\n### The critics behind Corr.\n",
        critic_table(results.critic),
        "",
        results.critic_notes,
    ]
    return "\n".join(parts)


def validation_table(on_val: Mapping[str, Mapping[str, float]]) -> str:
    """The figures of val that choices are made by; distances in units of that of true takes, if a sound has two."""
    floor = on_val.get("truth")
    headings = ["", "eye speed", "saccade amplitude", "eccentricity", "tie: eyes", "gaze in space", "head"]
    rows = []
    for name in order_rows(on_val):
        found = on_val[name]
        distances = [
            f"{found[each] / floor[each]:.1f}" if floor else f"{found[each]:.3f}" for each in VALIDATION_DISTANCES
        ]
        ties = ["" if np.isnan(found[each]) else f"{found[each]:.3f}" for each in VALIDATION_TIES]
        rows.append([TITLES.get(name, name), *distances, *ties])
    return markdown_table(headings, rows)


def aversion_table(aversions: Mapping[str, Any]) -> str:
    """What speech tells about averted gaze in every row, as Markdown."""
    keys = {
        "prediction": "true aversions",
        "information": "information",
        "shifted_information": "shifted",
        "live_information": f"at most {LIVE_LOOKAHEAD_S:g} s ahead",
    }
    rows = []
    for name in order_rows(aversions):
        found = aversions[name]
        estimates = [found.get(key) for key in keys]
        cells = ["{value:.4f} ({low:.4f} to {high:.4f})".format(**each) if each else "" for each in estimates]
        rows.append([TITLES.get(name, name), *cells, f"{found['changes_per_s']:.2f}"])
    return markdown_table(["", *keys.values(), "changes per second"], rows)


def emotion_table(emotions: Mapping[str, Any]) -> str:
    """How often the emotion of every row is recognised, as Markdown."""
    recognised = "{value:.2f} ({speakers_low:.2f} to {speakers_high:.2f})"
    rows = [
        [TITLES.get(name, name), recognised.format(**emotions[name]["recognised"]), f"{emotions[name]['chance']:.3f}"]
        for name in order_rows(emotions)
    ]
    return markdown_table(["", "emotion recognised", "chance"], rows)


def _uses_sound(row: Mapping[str, Any]) -> bool:
    """Whether motion is more likely under its own sound than under another, by intervals that do not overlap."""
    own, other = (row.get("unseen", {}).get(sound, {}).get("total") for sound in ("own", "other"))
    return own is not None and other is not None and own["low"] > other["high"]


def learnt_counts(benchmarks: Mapping[str, Sequence[MetricResult]]) -> str:
    """How many learnt metrics are worse than the truth, for each row; empty if none is compared."""
    counts = {name: count_learnt(rows) for name, rows in benchmarks.items()}
    listed = [f"{TITLES.get(name, name)}: {each.worse} of {each.compared}" for name, each in counts.items()]
    if not any(each.compared for each in counts.values()):
        return ""
    return (
        "Metrics worse than the truth, of those that the default model learns without correction: "
        f"{'; '.join(listed)}.\n"
    )


def _benchmarks(folder: Path, names: list[str]) -> dict[str, list[MetricResult]]:
    """The gaze benchmark of each row; rows without values are excluded."""
    tables = {name: from_json(_json(folder / name / "benchmark.json")) for name in names}
    return {name: table for name, table in tables.items() if any(row.value for row in table)}


def _upstream(table8: Path, counts: Mapping[str, Float[ndarray, " K"]]) -> list[Requirement]:
    found = []
    if table8.exists():
        fitted = next(row for row in _json(table8)["rows"] if row["method"] == "lightgazefit")
        if "error_px" in fitted:
            found.append(Requirement("fit: pupil error, pixels", fitted["error_px"], maximum=MAX_ERROR_PX))
            ratio = fitted["velocity_ratio"]
            found.append(Requirement("fit: eye-only speed to truth's", ratio, MIN_SPEED_RATIO, MAX_SPEED_RATIO))
    for name, used in counts.items():
        found.append(Requirement(f"{name}: fraction of codes in use", float((used > 0).mean()), minimum=MIN_CODE_USAGE))
    return found


def _most_takes(corpus: Corpus) -> list[Clip]:
    """The takes of the held-out sound that has the most; none in a corpus without held-out clips."""
    takes: dict[str, list[Clip]] = {}
    for clip in corpus.select("test", "unseen"):
        takes.setdefault(clip.sound, []).append(clip)
    sounds = sorted(takes, key=lambda sound: -len(takes[sound]))
    return sorted(takes[sounds[0]], key=lambda clip: clip.take) if sounds else []


def _draw_traces(workspace: Workspace, chosen: Sequence[Clip], path: Path) -> None:
    """Plot the truth, if it exists, and samples of a few models for the takes of a sound."""
    from talkingeyes.evaluation.report.plots import Trace, plot_traces

    corpus = Corpus(workspace.corpus)
    models = [name for name in TRACE_METHODS if workspace.data("sample", name).is_dir()]
    if not models:
        return
    traces = []
    if corpus.has_truth:
        motions = [corpus.truth(clip) for clip in chosen[:SAMPLES_DRAWN]]
        stacks = [np.stack([getattr(motion, name) for motion in motions]) for name in ("head", "gaze")]
        title = f"Truth, {len(motions)} takes" if len(motions) > 1 else "Truth"
        traces.append(Trace(title, Samples(chosen[0].fps, *stacks)))
    for name in models:
        samples = Samples.load(shard_path(workspace.data("sample", name), chosen[0].id, ".npz"))
        few = Samples(samples.fps, samples.head[:SAMPLES_DRAWN], samples.gaze[:SAMPLES_DRAWN])
        traces.append(Trace(TITLES[name], few))
    plot_traces(traces, corpus.speech(chosen[0]), SAMPLE_RATE, path)


def _speeds(folder: Path, names: list[str]) -> dict[str, dict[str, Float[ndarray, "2 N"]]]:
    """Distributions of speed: row to part to speeds and fractions."""
    found: dict[str, dict[str, Float[ndarray, "2 N"]]] = {}
    for name in names:
        points: dict[str, list[list[float]]] = {}
        with (folder / name / "speed.csv").open() as file:
            for line in csv.DictReader(file):
                points.setdefault(line["part"], []).append([float(line["speed_deg_s"]), float(line["share_faster"])])
        found[name] = {part: np.array(values).T for part, values in points.items()}
    return found


def _values(rows: Mapping[str, MethodMetrics]) -> dict[str, Any]:
    return {
        name: {
            split: {part: {key: each["value"] for key, each in figures.items()} for part, figures in parts.items()}
            for split, parts in row.items()
        }
        for name, row in rows.items()
    }


def flat_metrics(name: str, results: Results) -> dict[str, float]:
    """The figures of a row in the comparison of MLflow: all its metrics, information, ties, requirements met, and those
    on val."""
    values = _values({"own": results.rows[name], "fitted": results.rows.get("fitted", {})})
    found = _flat(values["own"])
    for split, parts in values["own"].items():
        for part in TIED_PARTS:
            tie, whole = (
                each.get(part, {}).get("corr_minus_shuffled") for each in (parts, values["fitted"].get(split, {}))
            )
            if tie is not None and whole:
                found[f"{split}/{part}/tie_ratio"] = tie / whole
    for split, sounds in results.informed.get(name, {}).items():
        found |= {f"{split}/information/{key}": each["value"] for key, each in sounds["own"].items()}
    found |= count_by_kind(results.required.get(name, ()))
    for key in ("information", "prediction"):
        if estimate := results.aversions.get(name, {}).get(key):
            found[f"aversion_{key}"] = estimate["value"]
    if name in results.emotions:
        found["emotion_recognised"] = results.emotions[name]["recognised"]["value"]
    return found | {f"val/{key}": value for key, value in results.on_val.get(name, {}).items()}


def _flat(row: Mapping[str, Any]) -> dict[str, float]:
    return {
        f"{split}/{part}/{key}": value
        for split, parts in row.items()
        for part, figures in parts.items()
        for key, value in figures.items()
    }


def _json_of_rows(folder: Path, name: str) -> dict[str, Any]:
    """The JSON file of this name of each row of a stage, by the name of the row."""
    return {path.parent.name: _json(path) for path in sorted(folder.glob(f"*/{name}"))}


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable ({error}); `make repro` writes it") from None


if __name__ == "__main__":
    main(run)
