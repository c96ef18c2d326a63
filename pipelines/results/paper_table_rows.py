"""Measurement of one row, a model or real motion, of the paper's tables (the page is written by
pipelines/results/tables.py)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from pipelines.evaluate import SPLITS, evaluate_sound, held_out_sounds
from pipelines.results.table_runs import METRICS_FILE
from talkingeyes.core.progress import progress_bar
from talkingeyes.corpus.recordings import Recordings
from talkingeyes.corpus.sound_groups import SoundGroup
from talkingeyes.evaluation.measures.evaluators import Evaluators
from talkingeyes.evaluation.papers.talkingeyes_metrics import EvaluateSettings
from talkingeyes.evaluation.papers.talkingeyes_results import SoundMetrics, high_frequency_motion, sound_metrics
from talkingeyes.evaluation.papers.talkingeyes_tables import REFERENCES
from talkingeyes.orchestration.run import InputPaths, Report, Workspace
from talkingeyes.orchestration.stage_graph import StageCall
from talkingeyes.training.motion_generators import Speech, load_generator

# Long motions for Table VI: one for the concatenated sounds of each speaker, up to this length; speakers per split.
LONG_S, LONG_SPEAKERS = 60.0, 12
# Code that a row depends on besides its inputs.
ROW_CODE = (
    "pipelines/evaluate.py",
    "pipelines/results/paper_table_rows.py",
    "src/talkingeyes/training",
    "src/talkingeyes/evaluation",
)
READS = ("data/critic",)
# {"speaker": name, "metrics": {metric: value}} of one sound or of one long motion.
Measured = Mapping[str, Any]


def measure_row(call: StageCall, workspace: Workspace) -> Report:
    """Metrics of a row: `sounds` and `long`, by split a list of {"speaker": name, "metrics": {metric: value}}."""
    settings = workspace.settings("evaluate", EvaluateSettings)
    (row,), data = call.names, workspace.data
    paths = workspace.input_paths(row)
    work = held_out_sounds(paths, settings)
    evaluators = Evaluators.load(paths.critic) if work else None
    sounds: dict[str, list[Measured]] = {split: [] for split in SPLITS}
    long: dict[str, list[Measured]] = {split: [] for split in SPLITS}
    for item in progress_bar(work, f"{call.stage} {row}"):
        assert evaluators is not None
        seen = evaluate_sound(paths, evaluators, item)
        if seen is None:
            continue
        clip, samples = item.clip, seen.case.samples
        sounds[clip.split].append(_measured(clip.speaker, sound_metrics(seen.case, seen.figures)))
        if row in REFERENCES:
            first = high_frequency_motion(samples.head[0], samples.gaze[0], clip.fps)
            long[clip.split].append(_measured(clip.speaker, first))
    if row not in REFERENCES:
        long = {split: _long(data("train", row), paths, _of_split(work, split)) for split in SPLITS}
    with workspace.output(call.stage, row) as folder:
        (folder / METRICS_FILE).write_text(json.dumps({"sounds": sounds, "long": long}))
    return Report()


def _of_split(work: Sequence[SoundGroup], split: str) -> list[SoundGroup]:
    return [item for item in work if item.takes[0].split == split]


def _measured(speaker: str, metrics: SoundMetrics) -> Measured:
    return {"speaker": speaker, "metrics": metrics}


def _long(model: Path, paths: InputPaths, work: Sequence[SoundGroup]) -> list[Measured]:
    """Long motions of a model: one for the concatenated sounds of each of the first speakers of a split."""
    generator = load_generator(model)
    clips = [item.clip for item in work]
    speakers, speeches = list(dict.fromkeys(clip.speaker for clip in clips))[:LONG_SPEAKERS], []
    for number, speaker in enumerate(speakers):
        own = [clip for clip in clips if clip.speaker == speaker]
        speech = _concatenated_speech(Recordings(own, paths.fit, paths.embed), int(LONG_S * own[0].fps))
        speeches.append(Speech(speech, [number], own[0].fps))
    motions = generator.generate_batch(speeches) if speeches else []
    return [
        _measured(speaker, high_frequency_motion(each.head[0], each.gaze[0], each.fps))
        for speaker, each in zip(speakers, motions, strict=True)
    ]


def _concatenated_speech(recordings: Recordings, frames: int) -> Float[ndarray, "T C"]:
    """The embedded speech of recordings, one after the other, up to a number of frames."""
    pieces: list[Float[ndarray, "_ C"]] = []
    for recording in recordings:
        pieces.append(np.asarray(recording.speech))
        if sum(map(len, pieces)) >= frames:
            break
    return np.concatenate(pieces)[:frames]
