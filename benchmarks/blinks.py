"""Blinks detected by `fit` on the real clips, compared with blinks counted by hand, frame by frame.

`blinks_by_eye.csv` beside this file lists the times: `whole` if the lids cover the pupil, `incomplete` if they fall and
rise without doing so. Incomplete blinks count neither as right nor as wrong; winks and narrowed eyes are not blinks.

Run     python -m pipelines.real_videos VIDEOS && python -m benchmarks.blinks
Reads   build/real/corpus, as written by pipelines/real_videos.py
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from talkingeyes.audio.waveform import SILENT_DBFS, loudest_dbfs
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import run_command

ROOT = Path("build/real/corpus")
MANUAL_BLINKS = Path(__file__).with_name("blinks_by_eye.csv")
TOLERANCE_S = 0.1  # tolerance between a manual time and a detected blink


@dataclass(frozen=True)
class BlinkCounts:
    """Counts of one clip: detected, those with a whole or only an incomplete blink; whole ones, those detected."""

    seconds: float
    found: int
    right: int
    incomplete: int
    whole: int
    whole_found: int


def manual_blinks() -> dict[str, list[tuple[float, str]]]:
    """Time and kind of every manually counted blink, by video."""
    counted = defaultdict(list)
    with MANUAL_BLINKS.open(newline="") as file:
        for row in csv.DictReader(file):
            counted[row["video"]].append((float(row["time_s"]), row["kind"]))
    return counted


def compare_blinks(spans_s: list[tuple[float, float]], moments: list[tuple[float, str]], seconds: float) -> BlinkCounts:
    """Compare detected spans with manual times, both in seconds of the clip."""
    holds = [
        {kind for time_s, kind in moments if start_s - TOLERANCE_S <= time_s <= stop_s + TOLERANCE_S}
        for start_s, stop_s in spans_s
    ]
    whole = [time_s for time_s, kind in moments if kind == "whole"]
    hit = [any(a - TOLERANCE_S <= time_s <= b + TOLERANCE_S for a, b in spans_s) for time_s in whole]
    right = sum("whole" in kinds for kinds in holds)
    incomplete = sum(kinds == {"incomplete"} for kinds in holds)
    return BlinkCounts(seconds, len(spans_s), right, incomplete, len(whole), sum(hit))


def main() -> None:
    """Print a line per clip, and the totals."""
    if not (ROOT / "clips.parquet").exists():  # make bench, without videos
        print(f"blinks: no tracked clips in {ROOT} (python -m pipelines.real_videos VIDEOS), nothing to measure")
        return
    settings = FitSettings.model_validate(compose(["fit=video"])["fit"])
    corpus, counted, rows = Corpus(ROOT), manual_blinks(), {}
    with (ROOT / "tracked.csv").open(newline="") as file:
        places = {row["clip"]: (row["video"], float(row["start_s"])) for row in csv.DictReader(file)}
    print(f"{'clip':<38}{'s':>7}{'by eye':>8}{'found':>7}{'right':>7}{'incomplete':>12}{'wrong':>7}{'missed':>8}")
    for clip in corpus.clips:
        video, start_s = places[clip.id]
        fit = fit_clip(corpus.observation(clip), settings)
        moments = [(time_s - start_s, kind) for time_s, kind in counted[video] if 0 <= time_s - start_s <= clip.seconds]
        spans_s = [(start / fit.motion.fps, (stop - 1) / fit.motion.fps) for start, stop in fit.lids.blinks]
        rows[clip.id] = compare_blinks(spans_s, moments, clip.seconds)
        print(line(clip.id, rows[clip.id]))
    voiced = [clip.id for clip in corpus.clips if loudest_dbfs(corpus.speech(clip)) >= SILENT_DBFS]
    total, speaking = pooled(rows.values()), pooled(rows[clip] for clip in voiced)
    print(line("all", total))
    print(line("those with a voice", speaking))
    for name, of in (("all", total), ("those with a voice", speaking)):
        minutes = of.seconds / 60
        print(f"blinks a minute, {name}: {of.whole / minutes:.1f} by eye, {of.found / minutes:.1f} found")
    print(
        f"precision {total.right / (total.found - total.incomplete):.2f}, recall {total.whole_found / total.whole:.2f}"
    )


def pooled(counts: Iterable[BlinkCounts]) -> BlinkCounts:
    """Sum the counts."""
    return BlinkCounts(*(sum(values) for values in zip(*(vars(count).values() for count in counts), strict=True)))


def line(name: str, of: BlinkCounts) -> str:
    """One row."""
    wrong, missed = of.found - of.right - of.incomplete, of.whole - of.whole_found
    return f"{name:<38}{of.seconds:7.1f}{of.whole:8d}{of.found:7d}{of.right:7d}{of.incomplete:12d}{wrong:7d}{missed:8d}"


if __name__ == "__main__":
    run_command(main)
