"""Stage `evaluate`: the figures of one row of Table III, on sounds that no model was trained or chosen on.

Run: python -m pipelines.evaluate talkingeyes
Rows: `truth` (the true motion; its takes are its samples), `fitted` (what models train on: the ceiling), `mismatched`
(fitted motion of other sounds of the speaker), or a model.
Reads: the corpus, data/fit, data/embed, data/critic, for a model data/sample/<model>.
Writes: data/evaluate/<row>/metrics.json {split: {part: {figure: {value, low, high}}}} and speed.csv (share of frames
that are faster). A corpus without truth has an empty row `truth`.
"""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.samples import Samples
from talkingeyes.corpus.store import Corpus, sharded
from talkingeyes.corpus.windows import Recording, Recordings
from talkingeyes.errors import InputError
from talkingeyes.metrics.bootstrap import Estimate
from talkingeyes.metrics.correlation import Correlation
from talkingeyes.metrics.evaluation import CRITICS, Case, EvaluateSettings, Figures, cropped, measure, summarise
from talkingeyes.motion import Motion
from talkingeyes.run import Report, Workspace, each, main

SPLITS = ("test", "unseen")
# Where the distribution of speed is written.
SPEEDS_DEG_S = np.geomspace(0.1, 1000, 81)
# Starting a process takes as long as measuring some fifty sounds.
SOUNDS_WORTH_A_PROCESS = 100


@dataclass(frozen=True)
class Sources:
    """Where the things lie that a row is made of."""

    row: str
    corpus: Path
    fit: Path
    embed: Path
    critic: Path
    sample: Path


@dataclass(frozen=True)
class Item:
    """A sound to measure: its fitted takes, the first of them take 0, and other sounds of the speaker."""

    takes: list[Clip]
    others: list[Clip]


def run(workspace: Workspace, name: str) -> Report:
    """Clip-parallel; the figures of a clip do not depend on the others."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    data = workspace.data
    sources = Sources(name, workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", name))
    found: dict[str, dict[str, list[Figures]]] = {split: {part: [] for part in CRITICS} for split in SPLITS}
    work = items(sources, settings)
    critics = {part: Correlation.load(sources.critic, part) for part in CRITICS.values()} if work else {}
    jobs = min(workspace.jobs, 1 + len(work) // SOUNDS_WORTH_A_PROCESS)
    measured = each(partial(evaluate, sources, critics), work, jobs, f"evaluate {name}")
    for item, figures in zip(work, measured, strict=True):
        for part, of_part in figures.items():
            found[item.takes[0].split][part].append(of_part)
    table = {
        split: {part: summarise(part, clips, settings.bootstrap) for part, clips in parts.items() if clips}
        for split, parts in found.items()
    }
    with workspace.output("evaluate", name) as folder:
        (folder / "metrics.json").write_text(json.dumps(_plain(table), indent=1))
        _write_speeds(folder / "speed.csv", found)
    return Report(metrics=_flat(table), artifacts=[data("evaluate", name, "metrics.json")])


def items(sources: Sources, settings: EvaluateSettings) -> list[Item]:
    """The sounds of test and unseen whose first take was fitted."""
    corpus = Corpus(sources.corpus)
    if sources.row == "truth" and not corpus.has_truth:
        return []
    takes, of_speaker = defaultdict(list), defaultdict(list)
    for clip in Recordings(corpus.clips, sources.fit, sources.embed).clips:
        takes[clip.sound].append(clip)
        if clip.take == 0:
            of_speaker[clip.speaker].append(clip)
    found = []
    for same in takes.values():
        clip = min(same, key=lambda each: each.take)
        if clip.split not in SPLITS or clip.take != 0:
            continue
        rivals = [other for other in of_speaker[clip.speaker] if other.sound != clip.sound]
        random = np.random.default_rng([settings.seed, *clip.id.encode()])
        chosen = random.choice(len(rivals), size=min(settings.mismatched, len(rivals)), replace=False)
        found.append(Item(sorted(same, key=lambda each: each.take), [rivals[index] for index in chosen]))
    if not found:
        raise InputError(f"{corpus.root}: no fitted clip in {' or '.join(SPLITS)}; Table III needs one")
    return found


def evaluate(sources: Sources, critics: dict[str, Correlation], item: Item) -> dict[str, Figures]:
    """The figures of one sound by part; none if the row has nothing for it (a speaker of one sound has no mismatch)."""
    corpus, clip = Corpus(sources.corpus), item.takes[0]
    takes = Recordings(item.takes, sources.fit, sources.embed)[:]
    fitted = stacked(clip.fps, takes)
    truth = stacked(clip.fps, [corpus.truth(take) for take in item.takes]) if corpus.has_truth else None
    samples = _samples(sources, item, fitted, truth)
    if samples is None:
        return {}
    frames = min(len(takes[0]), *(each.head.shape[1] for each in (samples, fitted, truth or fitted)))
    case = Case(
        speech=np.array(takes[0].speech[:frames]),
        samples=cropped(samples, frames),
        own=sources.row in ("truth", "fitted"),
        fitted=cropped(fitted, frames),
        truth=cropped(truth, frames) if truth else None,
        valid=takes[0].valid[:frames],
    )
    return measure(case, critics)


def _samples(sources: Sources, item: Item, fitted: Samples, truth: Samples | None) -> Samples | None:
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
