"""Stage `evaluate`: the figures of one row of Table III, on sounds that no model was trained or chosen on.

Run: python -m pipelines.evaluate talkingeyes
Rows: `truth` (the true motion; its takes are its samples), `fitted` (what models train on: the ceiling), `mismatched`
(fitted motion of other sounds of the speaker), or a model. A model of the face has the part `face` alone; truth and
fitted have it beside the others (`evaluate_face`).
Reads: the corpus, data/fit, data/embed, data/critic, for a model data/sample/<model>.
Writes: data/evaluate/<row>/metrics.json {split: {part: {figure: {value, low, high}}}}, speed.csv (share of frames
that are faster), and benchmark.json: the gaze benchmark on both splits together against the truth, all takes of it (in
a corpus without truth: the fitted motion). A corpus without truth has an empty row `truth`.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.evaluate_face import REAL, FaceSources, gives_face, measure_faces, shows_face
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.sounds import Sound, sounds
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.corpus.windows import Recording, Recordings
from talkingeyes.evaluation.benchmark.behaviour import with_references
from talkingeyes.evaluation.benchmark.paired import Compared, Counted, Paired, compared, counted, of_motions, of_samples
from talkingeyes.evaluation.benchmark.sound import CRITICS, OTHER_SOUNDS, Heard, hear
from talkingeyes.evaluation.bootstrap import Estimate
from talkingeyes.evaluation.evaluation import Case, EvaluateSettings, Figures, cropped, measure, summarise
from talkingeyes.evaluation.face.row import summarise_face
from talkingeyes.evaluation.judges import Judges
from talkingeyes.orchestration.run import Report, Workspace, each, main

SPLITS = ("test", "unseen")
# Where the distribution of speed is written.
SPEEDS_DEG_S = np.geomspace(0.1, 1000, 81)
# Starting a process takes as long as measuring some twenty sounds.
SOUNDS_WORTH_A_PROCESS = 40


@dataclass(frozen=True)
class Sources:
    """Where the things lie that a row is made of."""

    row: str
    corpus: Path
    fit: Path
    embed: Path
    critic: Path
    sample: Path
    benchmarked: int  # samples of a sound that the benchmark looks at


@dataclass(frozen=True)
class Measured:
    """What is kept of a sound: figures by part, and its part of the benchmark."""

    figures: dict[str, Figures]
    benchmark: Counted


def run(workspace: Workspace, name: str) -> Report:
    """Clip-parallel; the figures of a clip do not depend on the others."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    data = workspace.data
    sources = Sources(
        name, workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", name), settings.benchmarked
    )
    found: dict[str, dict[str, list[Figures]]] = {split: {part: [] for part in CRITICS} for split in SPLITS}
    work = items(sources, settings)
    of_face = gives_face(sources.sample)
    eyes = [] if of_face else work
    judges = Judges.load(sources.critic) if eyes else None
    jobs = min(workspace.jobs, 1 + len(work) // SOUNDS_WORTH_A_PROCESS)
    measured = each(partial(evaluate, sources, judges), eyes, jobs, f"evaluate {name}")
    benchmark = Paired()
    for item, one in zip(eyes, measured, strict=True):
        if one is None:
            continue
        benchmark.add(one.benchmark)
        for part, of_part in one.figures.items():
            found[item.takes[0].split][part].append(of_part)
    figures = {
        split: {part: summarise(part, clips, settings.bootstrap) for part, clips in parts.items() if clips}
        for split, parts in found.items()
    }
    if of_face or name in REAL:
        for split, of_split in _faces(sources, work, settings, jobs).items():
            figures[split]["face"] = of_split
    with workspace.output("evaluate", name) as folder:
        (folder / "metrics.json").write_text(json.dumps(_plain(figures), indent=1))
        (folder / "benchmark.json").write_text(benchmark.table(settings.bootstrap).json())
        _write_speeds(folder / "speed.csv", found)
    return Report(metrics=_flat(figures), artifacts=[data("evaluate", name, "metrics.json")])


def _faces(
    sources: Sources, work: Sequence[Sound], settings: EvaluateSettings, jobs: int
) -> dict[str, dict[str, Estimate]]:
    """The figures of the face, by split; none where motions have no face."""
    places = FaceSources(sources.row, sources.corpus, sources.fit, sources.sample, settings.seed)
    if not work or not shows_face(places, work[0].takes[0]):
        return {}
    measured = measure_faces(places, [item.takes for item in work], jobs)
    pairs = list(zip(work, measured, strict=True))
    by_split = {split: [one for item, one in pairs if item.takes[0].split == split] for split in SPLITS}
    return {split: summarise_face(ones, settings.bootstrap) for split, ones in by_split.items() if ones}


def items(sources: Sources, settings: EvaluateSettings) -> list[Sound]:
    """The sounds of test and unseen whose first take was fitted."""
    corpus = Corpus(sources.corpus)
    if sources.row == "truth" and not corpus.has_truth:
        return []
    found = sounds(corpus, sources.fit, sources.embed, SPLITS, settings.mismatched, settings.seed)
    if not found:
        raise InputError(f"{corpus.root}: no fitted clip in {' or '.join(SPLITS)}; Table III needs one")
    return found


@dataclass(frozen=True)
class Seen:
    """One sound of a row: what is compared, what the critics say of it, and its figures by part."""

    case: Case
    samples: Samples  # uncropped
    true: list[Motion] | None
    speech: Float[ndarray, "T C"]
    others: list[np.ndarray]
    heard: dict[str, Heard]
    figures: dict[str, Figures]


def look(sources: Sources, judges: Judges, item: Sound) -> Seen | None:
    """Measure one sound; None if the row has nothing for it (a speaker of one sound has no mismatch)."""
    corpus, clip = Corpus(sources.corpus), item.takes[0]
    takes = Recordings(item.takes, sources.fit, sources.embed)[:]
    fitted = stacked(clip.fps, takes)
    true = [corpus.truth(take) for take in item.takes] if corpus.has_truth else None
    truth = stacked(clip.fps, true) if true else None
    samples = _samples(sources, item, fitted, truth)
    if samples is None:
        return None
    frames = min(len(takes[0]), *(each.head.shape[1] for each in (samples, fitted, truth or fitted)))
    speech, others = np.array(takes[0].speech[:frames]), _other_sounds(sources, item)
    case = Case(
        samples=cropped(samples, frames),
        own=sources.row in ("truth", "fitted"),
        fitted=cropped(fitted, frames),
        truth=cropped(truth, frames) if truth else None,
        valid=takes[0].valid[:frames],
    )
    heard, fitted_heard = (
        hear(judges.critics, speech, sounds, each.head, each.gaze)
        for each, sounds in ((case.samples, others), (case.fitted, ()))
    )
    return Seen(case, samples, true, speech, others, heard, measure(case, heard, fitted_heard))


def evaluate(sources: Sources, judges: Judges | None, item: Sound) -> Measured | None:
    """The figures of one sound and its part of the gaze benchmark; None if the row has nothing for it."""
    assert judges is not None
    seen = look(sources, judges, item)
    if seen is None:
        return None
    beside = _compared(sources, item, seen.samples, seen.true)
    counts = counted(beside, seen.heard, judges.critics, judges.encoder, seen.speech, seen.others)
    return Measured(seen.figures, counts)


def _compared(sources: Sources, item: Sound, samples: Samples, true: list[Motion] | None) -> Compared:
    annotation = Corpus(sources.corpus).annotation(item.clip)
    of_truth = of_motions(true or (), annotation)
    if of_truth and sources.row == "truth":
        both = with_references(of_truth)
        return Compared(both, both)
    fits = []
    if sources.row == "fitted" or not of_truth:
        fits = of_motions(
            [Motion.load(sharded(sources.fit / "motion", take.id, ".npz")) for take in item.takes], annotation
        )
    count = sources.benchmarked
    drawn = Samples(samples.fps, samples.head[:count], samples.gaze[:count])
    return compared(fits if sources.row == "fitted" else of_samples(drawn, annotation), of_truth or fits)


def _other_sounds(sources: Sources, item: Sound) -> list[np.ndarray]:
    """Embeddings of a few other sounds of the speaker; none for mismatched motion, to which they may belong."""
    others = [] if sources.row == "mismatched" else item.others[:OTHER_SOUNDS]
    return [np.array(each.speech) for each in Recordings(others, sources.fit, sources.embed)]


def _samples(sources: Sources, item: Sound, fitted: Samples, truth: Samples | None) -> Samples | None:
    if sources.row == "truth":
        return truth
    if sources.row == "fitted":
        return fitted
    if sources.row == "mismatched":
        others = Recordings(item.others, sources.fit, sources.embed)[:]
        return stacked(item.takes[0].fps, others) if others else None
    return Samples.load(sharded(sources.sample, item.takes[0].id, ".npz"))


def stacked(fps: float, motions: Sequence[Motion | Recording]) -> Samples:
    """Motions as samples, cut to the shortest."""
    frames = min(map(len, motions))
    return Samples(
        fps,
        np.stack([motion.head[:frames].astype(float) for motion in motions]),
        np.stack([motion.gaze[:frames].astype(float) for motion in motions]),
    )


def _plain(table: dict[str, dict[str, dict[str, Estimate]]]) -> Any:
    return {
        split: {part: {name: asdict(each) for name, each in figures.items()} for part, figures in parts.items()}
        for split, parts in table.items()
    }


def _flat(table: dict[str, dict[str, dict[str, Estimate]]]) -> dict[str, float]:
    return {
        f"{split}/{part}/{name}": estimate.value
        for split, parts in table.items()
        for part, figures in parts.items()
        for name, estimate in figures.items()
    }


def _write_speeds(path: Path, found: dict[str, dict[str, list[Figures]]]) -> None:
    """Share of frames that are faster than each of SPEEDS_DEG_S, of both splits together."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["part", "speed_deg_s", "share_faster"])
        for part in CRITICS:
            speeds = [clip.speed for split in SPLITS for clip in found[split][part]]
            ordered = np.sort(np.concatenate(speeds)) if speeds else np.zeros(0)
            for speed in SPEEDS_DEG_S if len(ordered) else ():
                share = 1 - np.searchsorted(ordered, speed, side="right") / len(ordered)
                writer.writerow([part, f"{speed:.4g}", f"{share:.6g}"])


if __name__ == "__main__":
    main(run)
