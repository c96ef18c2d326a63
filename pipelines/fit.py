"""Stage `fit`: head, gaze and lids of every clip from its landmarks and pupils, the training targets of models.

Reads   the corpus (observations; truth, if there is one, only to report errors)
Writes  data/fit/motion/<shard>/<clip>.npz (Motion), rejected.csv (clip, reason), table8.json (the paper's Table VIII),
        blinks.json (distributions of blinks per minute) and speakers.json (styles), both of the train split's speakers,
        summary.json (head error, precision and recall of blinks)
Run     python -m pipelines.fit
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

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.fitting.accuracy import pool_errors
from talkingeyes.fitting.blink import blink_rate_distribution
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.fitting.comparison import BlinkMatches, FitEvaluation, GroundTruth, evaluate_fit
from talkingeyes.fitting.motion_style import (
    MIN_CLIP_S,
    SPEAKERS_FILE,
    MotionStyle,
    mean_style,
    measure_style,
    save_speakers,
)
from talkingeyes.orchestration.run import Report, Workspace, main, parallel_map

# Table VIII of the paper: 30 HDTF videos scaled to 224 x 224; pixels, and pixels per second at 25 fps.
PAPER = [
    {"method": "Ground Truth", "error_px": 0.0, "velocity_px_s": 16.2188, "velocity_ratio": 1.0},
    {"method": "Gaze360", "error_px": 1.4041, "velocity_px_s": 20.9604, "velocity_ratio": 1.2924},
    {"method": "LightGazeFit", "error_px": 0.7311, "velocity_px_s": 18.5380, "velocity_ratio": 1.1430},
]


@dataclass(frozen=True)
class ClipResult:
    """Result of one clip; a rejected one has a reason and no evaluation. `motion_style` is also None for short
    clips."""

    reject_reason: str
    blinks: int
    seconds: float
    evaluation: FitEvaluation | None
    motion_style: MotionStyle | None = None


def run(workspace: Workspace) -> Report:
    """Fit all clips, then pool the results."""
    settings = workspace.settings("fit", FitSettings)
    corpus = Corpus(workspace.corpus)
    clips = corpus.clips
    chosen = np.linspace(0, len(clips) - 1, min(settings.method_comparison.adam_clips, len(clips))).round().astype(int)
    by_adam = {clips[index].id for index in chosen}
    with workspace.output("fit") as folder:
        fit = partial(fit_one, corpus.root, folder / "motion", settings, by_adam)
        outcomes = list(parallel_map(fit, clips, workspace.jobs, "fit"))
        kept = [(clip, outcome) for clip, outcome in zip(clips, outcomes, strict=True) if not outcome.reject_reason]
        if not kept:
            raise InputError(
                f"fit: all {len(clips)} clips were rejected, the first because: {outcomes[0].reject_reason}"
            )
        _write_rejected(folder / "rejected.csv", clips, outcomes)
        train = [(clip, outcome) for clip, outcome in kept if clip.split == "train"]
        save_speakers(folder / SPEAKERS_FILE, speaker_styles(train))
        evaluations = [outcome.evaluation for _, outcome in kept if outcome.evaluation is not None]
        table, summary = method_comparison(evaluations), summarise(evaluations, len(clips))
        for name, content in {"table8": table, "blinks": blink_rate_summary(train), "summary": summary}.items():
            (folder / f"{name}.json").write_text(json.dumps(content, indent=1))
    return Report(metrics=dict(_metrics(table, summary)), artifacts=[workspace.data("fit", "table8.json")])


def fit_one(corpus_root: Path, motions: Path, settings: FitSettings, by_adam: set[str], clip: Clip) -> ClipResult:
    """Fit one clip and write its motion, unless it is rejected."""
    corpus = Corpus(corpus_root)
    observation = corpus.observation(clip)
    fit = fit_clip(observation, settings)
    outcome = ClipResult(fit.reject_reason, len(fit.lids.blinks), fit.motion.seconds, None)
    if fit.reject_reason:
        return outcome
    fit.motion.save(make_shard_path(motions, clip.id, ".npz"))
    truth = GroundTruth(corpus.truth(clip), corpus.truth_events(clip)) if corpus.has_truth else None
    evaluation = evaluate_fit(observation, fit, truth, settings, clip.id in by_adam)
    motion_style = measure_style(fit.motion) if fit.motion.seconds >= MIN_CLIP_S else None
    return ClipResult("", outcome.blinks, outcome.seconds, evaluation, motion_style)


def method_comparison(evaluations: Sequence[FitEvaluation]) -> dict[str, Any]:
    """Table VIII: one row per method, with ratios to the truth of the same clips; and the paper's own rows."""
    names = list(dict.fromkeys(name for evaluation in evaluations for name in evaluation.error_sums_by_method))
    return {
        "units": "pixels of the crop, pixels a second; frames without blinks; errors against noiseless pupils",
        "rows": [
            _row(name, [evaluation for evaluation in evaluations if name in evaluation.error_sums_by_method])
            for name in names
        ],
        "paper": PAPER,
    }


def _row(name: str, evaluations: Sequence[FitEvaluation]) -> dict[str, Any]:
    error_sums = pool_errors(evaluation.error_sums_by_method[name] for evaluation in evaluations)
    row: dict[str, Any] = {
        "method": name,
        "clips": len(evaluations),
        "error_to_input_px": error_sums.input_distance_px / max(error_sums.input_distances, 1),
        "velocity_px_s": error_sums.speed_px_s / max(error_sums.speeds, 1),
    }
    if name in evaluations[0].objectives:
        row["objective"] = float(np.mean([evaluation.objectives[name] for evaluation in evaluations]))
    if "ground_truth" in evaluations[0].error_sums_by_method:
        truth = pool_errors(evaluation.error_sums_by_method["ground_truth"] for evaluation in evaluations)
        row["error_px"] = error_sums.truth_distance_px / max(error_sums.truth_distances, 1)
        row["velocity_ratio"] = error_sums.speed_px_s / truth.speed_px_s if truth.speed_px_s else 0.0
        row["saccade_peak_ratio"] = error_sums.peak_px_s / truth.peak_px_s if truth.peak_px_s else 0.0
    return row


def summarise(evaluations: Sequence[FitEvaluation], clips: int) -> dict[str, Any]:
    """Means over clips: residual of the rigid landmarks and head error; precision and recall of blinks."""
    summary: dict[str, Any] = {
        "clips": clips,
        "rejected": clips - len(evaluations),
        "landmark_residual_px": float(np.mean([evaluation.residual_px for evaluation in evaluations])),
    }
    matches = [evaluation.match for evaluation in evaluations if evaluation.match is not None]
    if matches:
        match = sum(matches, BlinkMatches())
        summary |= {
            "head_error_deg": float(
                np.degrees(np.mean([v.head_error_rad for v in evaluations if v.head_error_rad is not None]))
            ),
            "head_error_mm": float(
                np.mean([v.translation_error_m for v in evaluations if v.translation_error_m is not None]) * 1e3
            ),
            "blink_precision": match.precision,
            "blink_recall": match.recall,
            "blinks_found": match.found,
            "blinks_true": match.true,
        }
    return summary


def blink_rate_summary(kept: Sequence[tuple[Clip, ClipResult]]) -> dict[str, Any]:
    """Blinks per minute over clips, as in the paper, and over speakers, whose longer counts have less variance."""
    speakers: dict[str, list[ClipResult]] = {}
    for clip, outcome in kept:
        speakers.setdefault(clip.speaker, []).append(outcome)
    by_clip = blink_rate_distribution([outcome.blinks for _, outcome in kept], [outcome.seconds for _, outcome in kept])
    by_speaker = blink_rate_distribution(
        [sum(outcome.blinks for outcome in group) for group in speakers.values()],
        [sum(outcome.seconds for outcome in group) for group in speakers.values()],
    )
    return {
        "units": "blinks a minute; log_normal: of the natural logarithm, over those with a blink",
        "clips": asdict(by_clip),
        "speakers": asdict(by_speaker),
        "paper": {"normal": {"mean": 40.10, "sd": 15.42}},
    }


def speaker_styles(kept: Sequence[tuple[Clip, ClipResult]]) -> dict[str, MotionStyle]:
    """Styles of the speakers, by name."""
    found: dict[str, list[tuple[MotionStyle, float]]] = {}
    for clip, outcome in kept:
        if outcome.motion_style is not None:
            found.setdefault(clip.speaker, []).append((outcome.motion_style, outcome.seconds))
    return {
        name: mean_style([motion_style for motion_style, _ in clips], [s for _, s in clips])
        for name, clips in found.items()
    }


def _write_rejected(path: Path, clips: Sequence[Clip], outcomes: Sequence[ClipResult]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["clip", "reason"])
        writer.writerows(
            (clip.id, outcome.reject_reason)
            for clip, outcome in zip(clips, outcomes, strict=True)
            if outcome.reject_reason
        )


def _metrics(table: dict[str, Any], summary: dict[str, Any]) -> list[tuple[str, float]]:
    rows = [(row["method"], name, value) for row in table["rows"] for name, value in row.items() if name != "method"]
    return [(f"{method}/{name}", float(value)) for method, name, value in rows] + [
        (name, float(value)) for name, value in summary.items()
    ]


if __name__ == "__main__":
    main(run)
