"""Stage `fit`: head, gaze and lids of every clip from its landmarks and pupils, the motion that models train on.

Reads   the corpus (observations; truth, if there is one, only to report errors)
Writes  data/fit/motion/<shard>/<clip>.npz (Motion), rejected.csv (clip, reason), table8.json (the paper's Table VIII),
        blinks.json (laws of blinks a minute), speakers.json (habits of the speakers of the train split),
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
from talkingeyes.corpus.store import Corpus, sharded_for_writing
from talkingeyes.fitting.accuracy import pooled
from talkingeyes.fitting.blink import rates
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.fitting.comparison import Match, Truth, Verdict, judge
from talkingeyes.fitting.manner import SHORTEST_S, SPEAKERS_FILE, Manner, in_all, measured, save_speakers
from talkingeyes.orchestration.run import Report, Workspace, each, main

# Table VIII of the paper: 30 HDTF videos brought down to 224 x 224; pixels, and pixels a second at 25 fps.
PAPER = [
    {"method": "Ground Truth", "error_px": 0.0, "velocity_px_s": 16.2188, "velocity_ratio": 1.0},
    {"method": "Gaze360", "error_px": 1.4041, "velocity_px_s": 20.9604, "velocity_ratio": 1.2924},
    {"method": "LightGazeFit", "error_px": 0.7311, "velocity_px_s": 18.5380, "velocity_ratio": 1.1430},
]


@dataclass(frozen=True)
class Outcome:
    """Of one clip; a rejected one has a reason and no verdict. `manner`: None, too, of a clip that is too short."""

    rejected: str
    blinks: int
    seconds: float
    verdict: Verdict | None
    manner: Manner | None = None


def run(workspace: Workspace) -> Report:
    """Fit all clips, then pool what was measured."""
    settings = workspace.settings("fit", FitSettings)
    corpus = Corpus(workspace.corpus)
    clips = corpus.clips
    chosen = np.linspace(0, len(clips) - 1, min(settings.table8.adam_clips, len(clips))).round().astype(int)
    by_adam = {clips[index].id for index in chosen}
    with workspace.output("fit") as folder:
        fit = partial(fit_one, corpus.root, folder / "motion", settings, by_adam)
        outcomes = list(each(fit, clips, workspace.jobs, "fit"))
        kept = [(clip, outcome) for clip, outcome in zip(clips, outcomes, strict=True) if not outcome.rejected]
        if not kept:
            raise InputError(f"fit: all {len(clips)} clips were rejected, the first because: {outcomes[0].rejected}")
        _write_rejected(folder / "rejected.csv", clips, outcomes)
        save_speakers(folder / SPEAKERS_FILE, speakers(kept))
        verdicts = [outcome.verdict for _, outcome in kept if outcome.verdict is not None]
        table, summary = table8(verdicts), summary_of(verdicts, len(clips))
        for name, content in {"table8": table, "blinks": blink_laws(kept), "summary": summary}.items():
            (folder / f"{name}.json").write_text(json.dumps(content, indent=1))
    return Report(metrics=dict(_metrics(table, summary)), artifacts=[workspace.data("fit", "table8.json")])


def fit_one(corpus_root: Path, motions: Path, settings: FitSettings, by_adam: set[str], clip: Clip) -> Outcome:
    """Fit one clip and write its motion, unless it is rejected."""
    corpus = Corpus(corpus_root)
    observation = corpus.observation(clip)
    fit = fit_clip(observation, settings)
    outcome = Outcome(fit.rejected, len(fit.lids.blinks), fit.motion.seconds, None)
    if fit.rejected:
        return outcome
    fit.motion.save(sharded_for_writing(motions, clip.id, ".npz"))
    truth = Truth(corpus.truth(clip), corpus.truth_events(clip)) if corpus.has_truth else None
    verdict = judge(observation, fit, truth, settings, clip.id in by_adam)
    manner = measured(fit.motion) if fit.motion.seconds >= SHORTEST_S else None
    return Outcome("", outcome.blinks, outcome.seconds, verdict, manner)


def table8(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Table VIII: one row a method, the ratios taken to the truth of the same clips; the paper's own rows beside it."""
    names = list(dict.fromkeys(name for verdict in verdicts for name in verdict.tallies))
    return {
        "units": "pixels of the crop, pixels a second; frames without blinks; errors against noiseless pupils",
        "rows": [_row(name, [verdict for verdict in verdicts if name in verdict.tallies]) for name in names],
        "paper": PAPER,
    }


def _row(name: str, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    tally = pooled(verdict.tallies[name] for verdict in verdicts)
    row: dict[str, Any] = {
        "method": name,
        "clips": len(verdicts),
        "error_to_input_px": tally.noisy_px / max(tally.noisies, 1),
        "velocity_px_s": tally.speed_px_s / max(tally.speeds, 1),
    }
    if name in verdicts[0].objectives:
        row["objective"] = float(np.mean([verdict.objectives[name] for verdict in verdicts]))
    if "ground_truth" in verdicts[0].tallies:
        truth = pooled(verdict.tallies["ground_truth"] for verdict in verdicts)
        row["error_px"] = tally.distance_px / max(tally.distances, 1)
        row["velocity_ratio"] = tally.speed_px_s / truth.speed_px_s if truth.speed_px_s else 0.0
        row["saccade_peak_ratio"] = tally.peak_px_s / truth.peak_px_s if truth.peak_px_s else 0.0
    return row


def summary_of(verdicts: Sequence[Verdict], clips: int) -> dict[str, Any]:
    """Means over clips: residual of the rigid landmarks, head error; precision and recall of blinks."""
    summary: dict[str, Any] = {
        "clips": clips,
        "rejected": clips - len(verdicts),
        "landmark_residual_px": float(np.mean([verdict.residual_px for verdict in verdicts])),
    }
    matches = [verdict.match for verdict in verdicts if verdict.match is not None]
    if matches:
        match = sum(matches, Match())
        summary |= {
            "head_error_deg": float(np.degrees(np.mean([v.head_rad for v in verdicts if v.head_rad is not None]))),
            "head_error_mm": float(np.mean([v.translation_m for v in verdicts if v.translation_m is not None]) * 1e3),
            "blink_precision": match.precision,
            "blink_recall": match.recall,
            "blinks_found": match.found,
            "blinks_true": match.true,
        }
    return summary


def blink_laws(kept: Sequence[tuple[Clip, Outcome]]) -> dict[str, Any]:
    """Blinks a minute over clips, as the paper counts them, and over speakers, whose long counts scatter less."""
    speakers: dict[str, list[Outcome]] = {}
    for clip, outcome in kept:
        speakers.setdefault(clip.speaker, []).append(outcome)
    by_clip = rates([outcome.blinks for _, outcome in kept], [outcome.seconds for _, outcome in kept])
    by_speaker = rates(
        [sum(outcome.blinks for outcome in group) for group in speakers.values()],
        [sum(outcome.seconds for outcome in group) for group in speakers.values()],
    )
    return {
        "units": "blinks a minute; log_normal: of the natural logarithm, over those with a blink",
        "clips": asdict(by_clip),
        "speakers": asdict(by_speaker),
        "paper": {"normal": {"mean": 40.10, "sd": 15.42}},
    }


def speakers(kept: Sequence[tuple[Clip, Outcome]]) -> dict[str, Manner]:
    """Habits of the speakers of the train split, by name."""
    found: dict[str, list[tuple[Manner, float]]] = {}
    for clip, outcome in kept:
        if clip.split == "train" and outcome.manner is not None:
            found.setdefault(clip.speaker, []).append((outcome.manner, outcome.seconds))
    return {name: in_all([manner for manner, _ in clips], [s for _, s in clips]) for name, clips in found.items()}


def _write_rejected(path: Path, clips: Sequence[Clip], outcomes: Sequence[Outcome]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["clip", "reason"])
        writer.writerows(
            (clip.id, outcome.rejected) for clip, outcome in zip(clips, outcomes, strict=True) if outcome.rejected
        )


def _metrics(table: dict[str, Any], summary: dict[str, Any]) -> list[tuple[str, float]]:
    rows = [(row["method"], name, value) for row in table["rows"] for name, value in row.items() if name != "method"]
    return [(f"{method}/{name}", float(value)) for method, name, value in rows] + [
        (name, float(value)) for name, value in summary.items()
    ]


if __name__ == "__main__":
    main(run)
