"""Baselines that the field ships, beside the models: the page docs/results/field_baselines.md.

Run     python -m pipelines.results.field_baselines [PEOPLE]        (after make report)
Reads   data/ (corpus, fit, embed, critic, evaluate, samples); PEOPLE, the fixations of recorded people
        (../shared/data/real/gaze/conversation_fixations.csv.gz); without them, the page has no distances to people
Writes  data/results/field_baselines.json and docs/results/field_baselines.md; works in build/field_baselines

Each baseline (pipelines/results/field_generators.py) is sampled on the sounds of test and unseen and evaluated by the
stage `evaluate`, with its settings. Not a stage: the default chain is not made longer.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pipelines import evaluate
from pipelines.results.field_generators import GENERATORS, FieldSound, SaccadeBank, generate
from pipelines.results.people import RECORDED
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.voice_activity import detect_speech
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import cyclopean_gaze, gaze_in_space
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import SampleSettings
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.evaluation.benchmark.comparison import MetricResult
from talkingeyes.evaluation.benchmark.table import from_json
from talkingeyes.evaluation.measures.metric import CLOSER, HIGHER
from talkingeyes.evaluation.papers.table3 import TITLES
from talkingeyes.evaluation.report.requirements import MARGIN, TIE, model_requirements, to_json
from talkingeyes.evaluation.text_tables import markdown_row
from talkingeyes.orchestration.run import Workspace, parallel_map, run_command
from talkingeyes.workflows.evaluate_people import MOTIONS, TRUTH, evaluate_people

DOCS, BUILD = Path("docs/results"), Path("build/field_baselines")
# Not beside the page: all metrics and intervals of all rows are 0.4 MB.
NUMBERS = Path("data/results/field_baselines.json")
DEFAULT = "talkingeyes_events"
# Rows that know nothing of the sound; they are compared with the default as the baselines are.
BLIND = ("random", "similar", "untrained")
ROWS = ("truth", DEFAULT, "talkingeyes", "talkingeyes_live", *BLIND)
MODELS = ROWS[1:]
COMPARED = (*BLIND, *GENERATORS)
FIELD_TITLES = {
    "uniform_eyes": "Uniform eyes",
    "replayed_saccades": "Replayed saccades",
    "loudness_sines": "Loudness sines",
    "rule_based": "Rules",
}
ROW_TITLES = {
    **TITLES,
    **FIELD_TITLES,
    DEFAULT: "TalkingEyes, events (default)",
    "talkingeyes_live": "TalkingEyes, live",
}
NEARER, FARTHER, UNDECIDED, ONLY_DEFAULT = "default nearer", "baseline nearer", "undecided", "default only"

# Columns of the requirements on the page.
SHOWN = (DEFAULT, *COMPARED)

PAGE = """# Baselines that the field ships

Programs that drive avatars today leave the eyes idle, random, replayed or rule-based. Four such ways are measured like
models: with the [gaze benchmark](../benchmark.md), the requirements of the report, and the distance to
[recorded people](people.md). This page is written by `python -m pipelines.results.field_baselines`, after `make
report`;
data/results/field_baselines.json has all rows, metrics and intervals.

## The baselines

They are written anew from public descriptions in `pipelines/results/field_generators.py`, which names its sources; no
code of the programs is used. A row is our reading of a description, not a measurement of the program.

{baselines}

## Requirements

The requirements of the report (data/report/requirements.json); bold: missed. Ratios compare the amount of motion, ties
say that it follows its sound. A head that sways with loudness has a tie at several times the speed of a head. Random,
Similar Sample and Untrained know nothing of the sound.

{requirements}

## The gaze benchmark, beside the default

For each metric, the distance to the truth of the default (`{default}`) and of a baseline, on the {sounds} sounds of
test and unseen. A row is *nearer* if its interval (95 %, over sounds) lies wholly below that of the other. Metrics that
are better when higher or lower are compared by their values. *Default only*: the baseline has too few events. Random
and Similar Sample are fitted motion of training clips.

{counts}

Where a program's baseline is nearer than the default:

{nearer}

## Recorded people

{people}

## Limits

- The data are synthetic ([data_card.md](../data_card.md)), and models are trained on them. Of the baselines only the
  replayed saccades are. Recorded people are the fairer comparison.
- Blinks, lids and brows of the programs are left out, as the samples of models have none. Still heads miss every
  requirement of the head.
- The default's settings were chosen on val ([model card](../model_card.md#how-it-was-chosen)); what descriptions leave
  open was set before the first run ([log](../log/2026-11-25-field-baselines.md)).
"""


class FieldWorkspace(Workspace):
    """The finished chain; samples and rows of the baselines are in build/field_baselines."""

    def data(self, *parts: str) -> Path:
        """A path under data/, or under the build folder for what belongs to a baseline."""
        own = len(parts) > 1 and parts[0] in ("sample", "evaluate") and parts[1] in GENERATORS
        return self.root.joinpath(BUILD if own else "data", *parts)


def compute(workspace: Workspace, recorded: Path | None) -> dict[str, Any]:
    """All rows: requirements, the benchmark beside the default's, and distances to recorded people."""
    missing = [name for name in (*ROWS, "fitted") if not workspace.data("evaluate", name, "metrics.json").is_file()]
    if missing:
        raise InputError(f"{workspace.data('evaluate')}: should hold {', '.join(missing)}, got none; run `make report`")
    sample(workspace)
    for name in GENERATORS:
        evaluate.run(workspace, name)
    names = (*ROWS, *GENERATORS)
    rows = {name: _json(workspace.data("evaluate", name, "metrics.json")) for name in (*names, "fitted")}
    pages = {name: _json(workspace.data("evaluate", name, "benchmark.json")) for name in names}
    tables = {name: from_json(page) for name, page in pages.items()}
    aversions = {name: _json(workspace.data("evaluate", name, "aversion.json")) for name in (*names, "fitted")}
    return {
        "schema": "talkingeyes.field_baselines/1",
        "sounds": pages[DEFAULT]["sounds"],
        "requirements": to_json({name: model_requirements(rows, tables, aversions, name) for name in names}),
        "benchmark": {name: compare(tables[DEFAULT], tables[name]) for name in COMPARED},
        "people": None if recorded is None else compare_people(workspace, recorded),
    }


def sample(workspace: Workspace) -> None:
    """Sample all baselines, with the settings of the stage `sample`."""
    settings, corpus = workspace.settings("sample", SampleSettings), Corpus(workspace.corpus)
    clips, bank = corpus.select("test", "unseen", take=0), saccade_bank(workspace, corpus)
    for name in GENERATORS:
        with workspace.output("sample", name) as folder:
            task = partial(_sample, name, corpus, bank, folder, settings)
            for _ in parallel_map(task, clips, workspace.jobs, f"sample {name}"):
                pass


def saccade_bank(workspace: Workspace, corpus: Corpus) -> SaccadeBank:
    """The saccades of the fitted training motions."""
    clips = corpus.select("train", take=0)
    paths = [shard_path(workspace.data("fit", "motion"), clip.id, ".npz") for clip in clips]
    motions = [Motion.load(path) for path in paths if path.is_file()]
    return SaccadeBank.of([cyclopean_gaze(gaze_in_space(each.head, each.gaze)) for each in motions], clips[0].fps)


def _sample(name: str, corpus: Corpus, bank: SaccadeBank, folder: Path, settings: SampleSettings, clip: Clip) -> None:
    sound, partner = corpus.speech(clip), corpus.partner(clip)
    turns = detect_speech(sound) if partner is None else detect_turns(sound, partner)
    speech = FieldSound(int(clip.seconds * clip.fps), clip.fps, sound, turns, bank)
    seeds = [[settings.seed, number, *clip.id.encode()] for number in range(settings.samples)]
    generate(name, speech, seeds).save(make_shard_path(folder, clip.id, ".npz"))


def compare(default: Sequence[MetricResult], baseline: Sequence[MetricResult]) -> list[dict[str, Any]]:
    """The default beside a baseline, metric by metric; metrics that the default lacks are left out."""
    others = {each.metric.name: each for each in baseline}
    found = []
    for ours in default:
        theirs = others[ours.metric.name]
        if ours.value is None:
            continue
        intervals = [distance_interval(ours), distance_interval(theirs)]
        found.append(
            {
                "metric": ours.metric.name,
                "title": ours.metric.title,
                "unit": ours.metric.unit,
                "truth": ours.reference.value if ours.reference else None,
                "default": [ours.value.value, ours.value.low, ours.value.high],
                "baseline": [theirs.value.value, theirs.value.low, theirs.value.high] if theirs.value else None,
                "verdict": verdict(*intervals),
            }
        )
    return found


def distance_interval(found: MetricResult) -> tuple[float, float] | None:
    """Interval of what should be small: the distance to the truth, or the value (negative if higher is better)."""
    if found.value is None:
        return None
    if found.metric.direction != CLOSER:
        low, high = found.value.low, found.value.high
        return (-high, -low) if found.metric.direction == HIGHER else (low, high)
    if found.difference is None:
        return None
    low, high = found.difference.low, found.difference.high
    return (0.0 if low <= 0 <= high else min(abs(low), abs(high)), max(abs(low), abs(high)))


def verdict(default: tuple[float, float] | None, baseline: tuple[float, float] | None) -> str:
    """Which of two intervals of a distance lies wholly below the other."""
    if default is None:
        return UNDECIDED
    if baseline is None:
        return ONLY_DEFAULT
    return NEARER if default[1] < baseline[0] else FARTHER if baseline[1] < default[0] else UNDECIDED


def compare_people(workspace: Workspace, recorded: Path) -> dict[str, Any]:
    """Distances of all rows to recorded people, by state."""
    first, *others = (*MODELS, *GENERATORS)
    folders = {name: workspace.data("sample", name) for name in others}
    content = evaluate_people(
        workspace.data("sample", first), recorded, reference=workspace.corpus, others=folders
    ).content
    rows = {TRUTH: TRUTH, MOTIONS: first} | {name: name for name in others}
    states = {
        state: {name: _distance(each["rows"][row]) for row, name in rows.items()}
        for state, each in content["states"].items()
    }
    return {"targets": content["targets"], "states": states}


def _distance(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: row[key] for key in ("mean_ratio", "largest", "auc", "seconds")}


def page(content: Mapping[str, Any]) -> str:
    """The page of a result."""
    return PAGE.format(
        baselines="\n".join(_descriptions()),
        requirements=_requirements(content["requirements"]),
        default=DEFAULT,
        sounds=content["sounds"],
        counts="\n".join(_counts(content["benchmark"])),
        nearer="\n".join(_nearer(content["benchmark"])),
        people="\n".join(_people(content["people"])),
    )


def _descriptions() -> Iterator[str]:
    """Each baseline: the first line of its docstring, and the program that it follows."""
    for name, generator in GENERATORS.items():
        text = " ".join((inspect.getdoc(generator) or "").split())
        program = text.partition("Source: ")[2].partition(" (")[0]
        yield f"- **{FIELD_TITLES[name]}** (`{name}`, after {program}). {text.partition(' Source: ')[0]}"


def _met(rows: Sequence[Mapping[str, Any]], kind: str) -> str:
    met = [row["met"] for row in rows if row["kind"] == kind]
    return f"{sum(met)} of {len(met)}"


def _listed(names: Sequence[str]) -> str:
    return "; ".join(names) or "none"


def _requirements(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    lines = [["requirement", "bounds", *(ROW_TITLES[name] for name in SHOWN)]]
    for each in zip(*(found[name] for name in SHOWN), strict=True):
        lines.append([each[0]["requirement"], each[0]["bounds"], *map(_required, each)])
    for kind, title in ((TIE, "ties met"), (MARGIN, "margins met")):
        lines.append([f"**{title}**", "", *(_met(found[name], kind) for name in SHOWN)])
    return "\n".join(_table(lines))


def _required(row: Mapping[str, Any]) -> str:
    if row["value"] is None:
        return ""
    value = f"{row['value']:.2f}"
    return value if row["met"] else f"**{value}**"


def _table(lines: Sequence[Sequence[str]]) -> list[str]:
    return [markdown_row(line) for line in (lines[0], ["---"] * len(lines[0]), *lines[1:])]


def _counts(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    verdicts = (NEARER, FARTHER, UNDECIDED, ONLY_DEFAULT)
    lines = [["baseline", *verdicts, "metrics"]]
    for name, rows in found.items():
        counts = [sum(row["verdict"] == each for row in rows) for each in verdicts]
        lines.append([ROW_TITLES[name], *map(str, [*counts, len(rows)])])
    return _table(lines)


def _nearer(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    lines = [["baseline", "metric", "unit", "truth", "default", "baseline's value"]]
    for name in GENERATORS:
        for row in found[name]:
            if row["verdict"] == FARTHER:
                truth = "" if row["truth"] is None else f"{row['truth']:.3g}"
                values = [f"{row['default'][0]:.3g}", f"{row['baseline'][0]:.3g}"]
                lines.append([ROW_TITLES[name], row["title"], row["unit"], truth, *values])
    return _table(lines) if len(lines) > 1 else ["None."]


def _people(found: Mapping[str, Any] | None) -> Iterator[str]:
    if found is None:
        yield "Not measured: the recordings were not there."
        return
    yield "Mean ratio to people, with its interval (95 %); 1 is the mean distance of two people. Definitions:"
    yield "[people.md](people.md).\n"
    targets = found["targets"]["mean_ratio"]
    names = list(dict.fromkeys(name for rows in found["states"].values() for name in rows))
    lines = [["row", *(f"{state} (at most {targets[state]:g})" for state in found["states"])]]
    for name in names:
        lines.append([ROW_TITLES[name], *(_ratio(rows.get(name)) for rows in found["states"].values())])
    yield from _table(lines)
    yield ""
    for state, rows in found["states"].items():
        ours = rows[DEFAULT]["mean_ratio"]
        rated: dict[str, list[str]] = {NEARER: [], FARTHER: [], UNDECIDED: []}
        for name in GENERATORS:
            theirs = rows[name]["mean_ratio"]
            both = [None if each is None else (each["low"], each["high"]) for each in (ours, theirs)]
            rated.get(verdict(*both), rated[UNDECIDED]).append(FIELD_TITLES[name])
        words = "; ".join(f"{key}: {', '.join(names) or 'none'}" for key, names in rated.items())
        yield f"- While {state}, by these intervals: {words}."


def _ratio(row: Mapping[str, Any] | None) -> str:
    found = row and row["mean_ratio"]
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f})" if found else "-"


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def main() -> None:
    """Measure, and write the page."""
    opened = Workspace.open(Path())
    workspace = FieldWorkspace(opened.root, opened.params)
    recorded = Path(sys.argv[1]) if sys.argv[1:] else RECORDED
    if sys.argv[1:] and not recorded.is_file():
        raise InputError(f"{recorded}: should be a table of fixations, got none")
    content = compute(workspace, recorded if recorded.is_file() else None)
    with atomic_write(NUMBERS) as temporary:
        temporary.write_text(json.dumps(content) + "\n")
    with atomic_write(DOCS / "field_baselines.md") as temporary:
        temporary.write_text(page(content))


if __name__ == "__main__":
    run_command(main)
