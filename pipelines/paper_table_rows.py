"""Measurement of one row, a model or real motion, of the paper's tables (the page is written by
pipelines/tables.py)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.evaluate import SPLITS, InputPaths, evaluate_sound, held_out_sounds
from pipelines.table_runs import METRICS_FILE
from talkingeyes.core.progress import progress_bar
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.corpus.sound_groups import SoundGroup
from talkingeyes.evaluation.critic.evaluators import Evaluators
from talkingeyes.evaluation.paper_metrics.summary import EvaluateSettings
from talkingeyes.evaluation.tables.definitions import REFERENCES
from talkingeyes.evaluation.tables.row_metrics import SoundMetrics, high_frequency_motion, sound_metrics
from talkingeyes.orchestration.run import Report, Workspace
from talkingeyes.orchestration.stage_graph import StageCall
from talkingeyes.training.motion_generators import load_generator

# Motions for Table VI: their length, and number per split, for concatenated sounds of the split.
LONG_S, LONG_MOTIONS = 60.0, 4
# Code that a row depends on besides its inputs.
ROW_CODE = (
    "pipelines/evaluate.py",
    "pipelines/paper_table_rows.py",
    "src/talkingeyes/training",
    "src/talkingeyes/evaluation",
)
READS = ("data/critic",)


def measure_row(call: StageCall, workspace: Workspace) -> Report:
    """Metrics of a row: {"sounds": {split: [metrics]}, "long": {split: [metrics]}}."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    places = (workspace.corpus, data("fit"), data("embed"), data("critic"), data("sample", row))
    paths = InputPaths(row, *places, settings.benchmark_samples)
    work = held_out_sounds(paths, settings)
    evaluators = Evaluators.load(paths.critic) if work else None
    sounds: dict[str, list[SoundMetrics]] = {split: [] for split in SPLITS}
    long: dict[str, list[SoundMetrics]] = {split: [] for split in SPLITS}
    for item in progress_bar(work, f"{call.stage} {row}"):
        assert evaluators is not None
        seen = evaluate_sound(paths, evaluators, item)
        if seen is None:
            continue
        split = item.takes[0].split
        sounds[split].append(sound_metrics(seen.case, seen.figures))
        if row in REFERENCES:
            long[split].append(
                high_frequency_motion(seen.case.samples.head[0], seen.case.samples.gaze[0], item.takes[0].fps)
            )
    if row not in REFERENCES:
        long = {split: _long(data("train", row), paths, _of_split(work, split)) for split in SPLITS}
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps({"sounds": sounds, "long": long}))
    return Report()


def _of_split(work: Sequence[SoundGroup], split: str) -> list[SoundGroup]:
    return [item for item in work if item.takes[0].split == split]


def _long(model: Path, paths: InputPaths, work: Sequence[SoundGroup]) -> list[SoundMetrics]:
    """Long motions of a model for the concatenated sounds of a split."""
    if not work:
        return []
    fps = work[0].takes[0].fps
    recordings = Recordings([item.takes[0] for item in work], paths.fit, paths.embed)
    speech_pieces: list[Float[ndarray, "_ C"]] = []
    for recording in recordings:
        speech_pieces.append(np.asarray(recording.speech))
        if sum(map(len, speech_pieces)) >= LONG_S * fps:
            break
    speech = np.concatenate(speech_pieces)[: int(LONG_S * fps)]
    made = load_generator(model).generate(speech, list(range(LONG_MOTIONS)), fps)
    return [high_frequency_motion(head, gaze, fps) for head, gaze in zip(made.head, made.gaze, strict=True)]
