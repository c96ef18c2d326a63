"""Comparison of a corpus, and of recorded people, with reference ranges of eye, head, lid and jaw movements.

Run     python -m pipelines.results.reference_ranges [CORPUS]        (make reference-ranges; make reference-ranges
        corpus=DIR)
Reads   the corpus of the workspace, or CORPUS; data/fit and data/embed beside it, if they exist; recordings of people
        in ../shared/data/real/gaze, if they exist
Writes  docs/results/reference_ranges.md and .csv, docs/results/pictures/reference-ranges-*.png; for another CORPUS
        build/reference_ranges/

Not a stage: nothing reads its output, and it reads the output of several stages. Takes of a synthetic corpus are
regenerated from their seeds, which gives the same events, and rendered at 500, 120, 60 and 25 fps.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pipelines.results import reference_ranges_page as page
from pipelines.results.audio_motion_probes import MATCHING, MAX_CLIPS, PROBES, measure_probes, measure_towers
from pipelines.results.regenerated_takes import extract_frame_rates, extract_further_takes, sound_of
from pipelines.results.result_tables import ResultTable, as_csv
from talkingeyes.audio.prosody import ProsodySettings, prosody
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.gaze_datasets import read_andersson, read_conversation, read_openface
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.measures import blinks, eye_head
from talkingeyes.evaluation.measures.critic import CriticSettings
from talkingeyes.evaluation.measures.pooled import ClipData, FrameProsody, PooledArrays, join_pools, no_measurement
from talkingeyes.evaluation.reference_ranges import measurements, plots, probes, recorded_people
from talkingeyes.evaluation.reference_ranges.corpus_inputs import CorpusInputs, reference_motion
from talkingeyes.evaluation.reference_ranges.measurements import RATES_FPS, Measurements
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.run import Workspace, parallel_backend, parallel_map, run_command
from talkingeyes.physiology.blinks import PAPER, PHYSIOLOGICAL, sample_blink_rate
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.speakers import sample_style

RECORDED = Path(__file__).resolve().parents[3] / "shared/data/real/gaze"
MAX_NATIVE_CLIPS = 300
CANDIDATES = 40  # candidate clips for the timeline
CONVERSATION = "conversation_fixations.csv.gz"
DRAWN_SPEAKERS, DRAWN_RATES = 500, 1000
STATUSES = ("within", "outside", "-")
INTRODUCTION = """# Reference ranges

Written by `make reference-ranges`. Each statistic of eyes, head, lids and jaw in speech has a range that a corpus
should meet, after published values of people. A range tests the data generator; it is not a claim about people.
Measured in `src/talkingeyes/evaluation/measures/`.

[reference_ranges.csv](reference_ranges.csv) has every statistic: published value, range, measured value, count, values
of recorded people, source. Where a range was changed, the previous one is in parentheses with the reason. Certainty of
a source: S* read, S well known, R recalled, U a prior only, D a choice, M computed.

Corpus: {what}."""


@dataclass(frozen=True)
class CorpusMeasurements:
    """Measurements of a corpus by reference range, and the pooled arrays for plots."""

    pool: PooledArrays
    measurements: Measurements


def source_of(workspace: Workspace, corpus: Path) -> CorpusInputs:
    """The corpus with its neighbouring data. Raises InputError if it has no clips."""
    found = Corpus(corpus)
    if not found.clips:
        raise InputError(f"{corpus}: should hold clips, got none; `make repro` makes a corpus")
    settings = workspace.settings("synthesize", plan.SynthesizeSettings) if found.has_truth else None
    data = corpus.parent
    return CorpusInputs(
        found,
        data / "fit",
        data / "embed",
        workspace.settings("embed.prosody", ProsodySettings),
        workspace.settings("critic", CriticSettings),
        settings,
    )


def load_clip_data(corpus_inputs: CorpusInputs, clip: Clip) -> ClipData:
    """One clip with all data about it."""
    motion, annotation = reference_motion(corpus_inputs, clip), corpus_inputs.corpus.annotation(clip)
    speech = corpus_inputs.corpus.speech(clip)
    sound_prosody = prosody(speech, motion.fps, corpus_inputs.prosody)
    fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
    return ClipData(
        speaker=clip.speaker,
        behaviour=behaviour(motion.fps, fields, motion.valid, annotation),
        motion=motion,
        annotation=annotation,
        frame_prosody=FrameProsody(sound_prosody.energy_dbfs, sound_prosody.f0_hz),
        events=corpus_inputs.corpus.truth_events(clip) if corpus_inputs.corpus.has_truth else None,
        axis_divergence_rad=axis_divergence_rad(corpus_inputs, clip),
    )


def axis_divergence_rad(corpus_inputs: CorpusInputs, clip: Clip) -> float:
    """Difference in divergence between the optical axes and the lines of sight of a synthetic speaker."""
    if corpus_inputs.settings is None:
        return 0.0
    left, right = plan.speaker_of(corpus_inputs.settings, sound_of(corpus_inputs.settings, clip)).style.kappa
    return left[0] - right[0]


def extract_sound(corpus_inputs: CorpusInputs, takes: Sequence[Clip]) -> dict[str, np.ndarray]:
    """Pooled arrays of all takes of one sound, with the variance between takes."""
    seen = [load_clip_data(corpus_inputs, clip) for clip in takes]
    pool = join_pools(measurements.extract(one) for one in seen)
    if len(takes) > 1:
        parts = {
            "eye": [one.behaviour.eye_rad.mean(axis=1) for one in seen],
            "head": [one.behaviour.head for one in seen],
            "jaw": [one.motion.jaw[:, :1] for one in seen if one.motion is not None],
        }
        pool |= {f"takes.{part}": probes.between_take_variance(np.stack(each))[None] for part, each in parts.items()}
    return pool


def measure_corpus(corpus_inputs: CorpusInputs, jobs: int) -> CorpusMeasurements:
    """All measurements of a corpus, and the pooled arrays for plots."""
    sounds = select_sounds(corpus_inputs.corpus.clips)
    firsts = [takes[0] for takes in sounds]
    pool = join_pools(parallel_map(partial(extract_sound, corpus_inputs), sounds, jobs, "reference ranges: clips"))
    found = (
        measurements.measure_gaze(pool)
        | measurements.measure_head(pool)
        | measurements.measure_speech(pool)
        | measurements.measure_prosody(pool)
    )
    found |= (
        measurements.measure_blinks(pool) | measurements.measure_lids(pool) | measurements.measure_take_variance(pool)
    )
    found |= (
        measurements.measure_gaze_shifts(pool)
        | measure_blink_rate_draws(corpus_inputs)
        | measurements.measure_eye_aspect_ratio()
        | measure_fit(corpus_inputs)
    )
    if corpus_inputs.settings is not None:
        fast = join_pools(
            parallel_map(
                partial(extract_frame_rates, corpus_inputs.corpus, corpus_inputs.settings),
                firsts[:MAX_NATIVE_CLIPS],
                jobs,
                "reference ranges: frame rates",
            )
        )
        more = join_pools(
            parallel_map(
                partial(extract_further_takes, corpus_inputs.corpus, corpus_inputs.settings),
                firsts[:MAX_NATIVE_CLIPS],
                jobs,
                "reference ranges: further takes",
            )
        )
        found |= (
            measurements.measure_gaze_shifts(more)
            | measurements.measure_main_sequence(fast)
            | blinks.blink_kinematics(fast)
            | {"head_onset_lag": eye_head.onset_lag_ms(pool)}
        )
        pool = {**pool, **fast}
    if (corpus_inputs.embed / "embedding.json").is_file():
        found |= measure_probes(corpus_inputs, firsts, jobs) | measure_towers(corpus_inputs, jobs)
    else:
        found |= dict.fromkeys((*PROBES, *MATCHING), no_measurement("no speech features: the stage embed has not run"))
    return CorpusMeasurements(pool, found)


def measure_blink_rate_draws(corpus_inputs: CorpusInputs) -> Measurements:
    """Sampled blink rates, of speakers and of the paper's profile."""
    seed = corpus_inputs.settings.seed if corpus_inputs.settings else 0
    rng = np.random.default_rng(seed)
    generators = (plan.seeded_generator(seed, "speaker", index) for index in range(DRAWN_SPEAKERS))
    return measurements.measure_blink_rate_draws(
        [sample_blink_rate(PAPER, rng) for _ in range(DRAWN_RATES)],
        [sample_style(each, PHYSIOLOGICAL).blinks_per_min for each in generators],
    )


def measure_fit(corpus_inputs: CorpusInputs) -> Measurements:
    """Table VIII, if the corpus has been fitted."""
    path = corpus_inputs.fit / "table8.json"
    if not path.is_file():
        return dict.fromkeys(
            ("fit_error", "fit_peak", "fit_speed"), no_measurement("not fitted: the stage fit has not run")
        )
    return measurements.measure_fit(json.loads(path.read_text()))


def select_sounds(clips: Sequence[Clip]) -> list[list[Clip]]:
    """Sounds with all their takes, spread evenly over the corpus."""
    takes: dict[str, list[Clip]] = {}
    for clip in clips:
        takes.setdefault(clip.sound, []).append(clip)
    every = max(1, -(-len(clips) // MAX_CLIPS))
    return list(takes.values())[::every]


@dataclass(frozen=True)
class RecordedMeasurements:
    """Measurements of recorded people, and their saccades, by the letter of the source on the page."""

    measurements: dict[str, Measurements]
    pools: dict[str, PooledArrays]


def measure_recordings(folder: Path) -> RecordedMeasurements:
    """Measurements of the recordings in a folder; empty if there are none."""
    tracked = [read_andersson(path).recording for path in sorted(folder.glob("andersson_*_MN.mat"))]
    filmed = [read_openface(path) for path in sorted(folder.glob("openface_*.csv.gz"))]
    found, pools = {}, {}
    if tracked:
        found["T"], pools["T"] = recorded_people.measure_eye_tracking(tracked), recorded_people.tracking_pool(tracked)
    if (folder / CONVERSATION).is_file():
        talk = read_conversation(folder / CONVERSATION)
        found["C"], pools["C"] = recorded_people.measure_conversation(talk), recorded_people.conversation_pool(talk)
    if filmed:
        found["V"] = recorded_people.measure_video(filmed)
    return RecordedMeasurements(found, pools)


def timeline_clip(corpus_inputs: CorpusInputs) -> Clip:
    """The clip of the timeline: among the first, one with several aversions and blinks, and with listening if
    possible."""
    best, most = corpus_inputs.corpus.clips[0], -1
    for clip in corpus_inputs.corpus.clips[:CANDIDATES]:
        seen = load_clip_data(corpus_inputs, clip)
        assert seen.annotation is not None
        events = min(int(seen.behaviour.states.dwell_averted.sum()), 3) + min(len(seen.behaviour.blinks), 3)
        value = events + 10 * bool(seen.annotation.listening)
        if value > most:
            best, most = clip, value
    return best


def write(
    out: Path, corpus_inputs: CorpusInputs, found: CorpusMeasurements, recorded: RecordedMeasurements, what: str
) -> None:
    """Write the page and its pictures, each file atomically."""
    pictures = out / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    plotters: dict[str, Callable[[Path], None]] = {
        "distributions": partial(plots.distributions, found.pool, recorded.pools),
        "timeline": lambda path: plots.timeline(
            load_clip_data(corpus_inputs, clip), corpus_inputs.corpus.speech(clip), path
        ),
    }
    clip = timeline_clip(corpus_inputs)
    if f"at{RATES_FPS[0]}.amplitude_deg" in found.pool:
        plotters = {"main-sequence": partial(plots.main_sequence, found.pool), **plotters}
    for name, draw in plotters.items():
        with atomic_write(pictures / f"reference-ranges-{name}.png") as path:
            draw(path)
    links = {name: f"pictures/reference-ranges-{name}.png" for name in plotters}
    rows = page.table_rows(found.measurements, recorded.measurements)
    tables = {title: ResultTable(title, page.COLUMNS, each) for title, each in rows.items()}
    for name, text in (
        ("reference_ranges.csv", as_csv(tables.values())),
        ("reference_ranges.md", summary(tables, list(recorded.measurements), what, links)),
    ):
        with atomic_write(out / name) as path:
            path.write_text(text)


def summary(tables: Mapping[str, ResultTable], recorded: Sequence[str], what: str, links: Mapping[str, str]) -> str:
    """The page: counts by section, and the values outside their range."""
    status = {name: [row[4].strip("*") or "-" for row in table.rows] for name, table in tables.items()}
    counts = [[name, *(str(found.count(each)) for each in STATUSES)] for name, found in status.items()]
    total = [sum(found.count(each) for found in status.values()) for each in STATUSES]
    rows = [row for table in tables.values() for row in table.rows]
    parts = [
        INTRODUCTION.format(what=what),
        markdown_table(["section", "within", "outside", "no value"], [*counts, ["all", *map(str, total)]]),
        "## Outside the range",
        _rows([row for row in rows if row[4].strip("*") == "outside"]),
        "## Beside recordings of people",
        "\n".join(f"- {name}: {page.RECORDING_TITLES[name]}" for name in recorded),
        _rows([row for row in rows if row[6] != "-"]),
        *(f"![{page.PLOT_CAPTIONS[name]}]({path})\n\n{page.PLOT_CAPTIONS[name]}" for name, path in links.items()),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _rows(rows: Sequence[Sequence[str]]) -> str:
    """Rows of the page without the columns that only the CSV has."""
    shown = [[row[0], *row[2:4], row[6]] for row in rows]
    return markdown_table(["statistic", "range", "measured", "recordings"], shown) if rows else "None."


def describe_corpus(corpus_inputs: CorpusInputs) -> str:
    """Description of a corpus, without machine-dependent data, so that the page is reproducible."""
    clips = corpus_inputs.corpus.clips
    minutes = sum(clip.seconds for clip in clips) / 60
    speakers = len({clip.speaker for clip in clips})
    kind = "synthetic, true motion" if corpus_inputs.corpus.has_truth else "tracked, fitted motion"
    sounds = len({clip.sound for clip in clips})
    return f"{kind}, {len(clips)} clips of {sounds} sounds, {speakers} speakers, {minutes:.0f} minutes"


def main() -> None:
    """Measure, print and write."""
    workspace = Workspace.open(Path.cwd())
    if len(sys.argv) > 2:
        raise InputError(f"reference ranges: should get one corpus or none, got {' '.join(sys.argv[1:])}")
    other = Path(sys.argv[1]) if sys.argv[1:] else None
    corpus_inputs = source_of(workspace, other or workspace.corpus)
    out = workspace.root / (Path("docs/results") if other is None else Path("build", "reference_ranges"))
    with parallel_backend(workspace.params.get("machine", {})):
        found = measure_corpus(corpus_inputs, workspace.jobs)
    recorded = measure_recordings(RECORDED)
    write(out, corpus_inputs, found, recorded, describe_corpus(corpus_inputs))
    print(page.as_text(found.measurements, recorded.measurements))
    print(f"written: {out / 'reference_ranges.md'}")


if __name__ == "__main__":
    run_command(main)
