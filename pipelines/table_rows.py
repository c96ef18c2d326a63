"""What is measured of a model, or of real motion, for the paper's tables (pipelines/tables.py writes their page)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.evaluate import SPLITS, Sources, items, look
from pipelines.rows import FIGURES
from talkingeyes.corpus.sounds import Sound
from talkingeyes.corpus.windows import Recordings
from talkingeyes.evaluation.evaluation import EvaluateSettings
from talkingeyes.evaluation.judges import Judges
from talkingeyes.evaluation.tables.declared import REFERENCES
from talkingeyes.evaluation.tables.row import Numbers, fast, numbers
from talkingeyes.orchestration.recipe import Call
from talkingeyes.orchestration.run import Report, Workspace, progress
from talkingeyes.training.trained import load_generator

# Motions for Table VI: this long, this many of each split, under its sounds one after the other.
LONG_S, LONG_MOTIONS = 60.0, 4
# What a row follows from beside what it reads.
ROW_CODE = (
    "pipelines/evaluate.py",
    "pipelines/table_rows.py",
    "src/talkingeyes/training",
    "src/talkingeyes/evaluation",
)
READS = ("data/critic",)


def measure(call: Call, workspace: Workspace) -> Report:
    """The numbers of a row: {"sounds": {split: [numbers]}, "long": {split: [numbers]}}."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    places = (workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", row))
    sources = Sources(row, *places, settings.benchmarked)
    work = items(sources, settings)
    judges = Judges.load(sources.critic) if work else None
    sounds: dict[str, list[Numbers]] = {split: [] for split in SPLITS}
    long: dict[str, list[Numbers]] = {split: [] for split in SPLITS}
    for item in progress(work, f"{call.stage} {row}"):
        assert judges is not None
        seen = look(sources, judges, item)
        if seen is None:
            continue
        split = item.takes[0].split
        sounds[split].append(numbers(seen.case, seen.figures))
        if row in REFERENCES:
            long[split].append(fast(seen.case.samples.head[0], seen.case.samples.gaze[0], item.takes[0].fps))
    if row not in REFERENCES:
        long = {split: _long(data("train", row), sources, _of_split(work, split)) for split in SPLITS}
    with workspace.output(call.stage, row) as folder:
        (folder / FIGURES).write_text(json.dumps({"sounds": sounds, "long": long}))
    return Report()


def _of_split(work: Sequence[Sound], split: str) -> list[Sound]:
    return [item for item in work if item.takes[0].split == split]


def _long(model: Path, sources: Sources, work: Sequence[Sound]) -> list[Numbers]:
    """Long motions of a model under the sounds of a split, end to end."""
    if not work:
        return []
    fps = work[0].takes[0].fps
    recordings = Recordings([item.takes[0] for item in work], sources.fit, sources.embed)
    heard: list[Float[ndarray, "_ C"]] = []
    for recording in recordings:
        heard.append(np.asarray(recording.speech))
        if sum(map(len, heard)) >= LONG_S * fps:
            break
    speech = np.concatenate(heard)[: int(LONG_S * fps)]
    made = load_generator(model).generate(speech, list(range(LONG_MOTIONS)), fps)
    return [fast(head, gaze, fps) for head, gaze in zip(made.head, made.gaze, strict=True)]
