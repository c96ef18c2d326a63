"""Tracking and fitting of real videos: the table of docs/results/real_videos.md.

Run     python -m pipelines.results.real_videos VIDEOS      (make real-videos)
Reads   a folder of videos of real people or made from them (never part of the project); prints one line if it is absent
Writes  build/real/corpus (a tracked corpus; clips without a voice too), build/real/real.json
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from talkingeyes.core.errors import InputError
from talkingeyes.core.rotation import gaze_to_angles
from talkingeyes.core.settings import validate_section
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.fitting.clip import FitSettings, fit_clip
from talkingeyes.orchestration.config import compose
from talkingeyes.orchestration.run import parallel_map, run_command
from talkingeyes.tracking.report import as_text
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.video import probe_video
from talkingeyes.workflows.track import track

FOLDER = Path("build/real")
MIN_GAZE_RANGE_DEG = 8.0  # eye-in-head yaw, 5 to 95 %; above it, gaze counts as moving
MAX_FRONTAL_YAW_DEG = 12.0  # median head yaw below which a clip counts as frontal
BLINKS_PER_MINUTE = (15.0, 35.0)
MIN_EYE_CORRELATION = 0.8
UNINFORMATIVE_SD_RAD = 10.0  # an uninformative prior on changes of vergence


@dataclass(frozen=True)
class RealClipResult:
    """Result of one clip. Correlations of yaw: between both eyes, and between eyes and head; angles in degrees.

    For the correlation of both eyes, each eye is fitted without the vergence prior, which would make them agree.
    """

    clip: str
    fps: float
    seconds: float
    reject_reason: str
    residual_px: float
    head_yaw: float
    gaze_range: float
    eye_correlation: float
    eye_head_correlation: float
    blinks: int


def evaluate_real_videos(videos: Path, jobs: int) -> list[RealClipResult]:
    """Track and fit all clips, print the table, and return its rows."""
    params = compose(["fit=video", "track.clip_filter.require_voice=false", "track.thumbnails=false"])
    tracked = track([videos], FOLDER / "corpus", validate_section("track", TrackSettings, params["track"]), jobs=jobs)
    print(as_text(tracked.outcomes))
    for line in (FOLDER / "corpus/rejected.csv").read_text().splitlines()[1:]:
        print("  rejected:", line)
    settings = validate_section("fit", FitSettings, params["fit"])
    rates = {outcome.source.id: probe_video(outcome.source.path).fps for outcome in tracked.outcomes if outcome.entries}
    fit = partial(measure_fit, tracked.corpus, settings, rates)
    rows = list(parallel_map(fit, tracked.corpus.clips, jobs, "fit"))
    print(table(rows))
    (FOLDER / "real.json").write_text(json.dumps([asdict(row) for row in rows], indent=1))
    return rows


def measure_fit(corpus: Corpus, settings: FitSettings, rates: Mapping[str, float], clip: Clip) -> RealClipResult:
    """Fit one clip and measure its yaw."""
    fit = fit_clip(corpus.observation(clip), settings)
    motion = fit.motion
    alone = settings.eye_calibration.model_copy(update={"vergence_sd_rad": UNINFORMATIVE_SD_RAD})
    by_itself = fit_clip(corpus.observation(clip), settings.model_copy(update={"eye_calibration": alone})).motion
    eyes_rad = gaze_to_angles(by_itself.gaze)[motion.valid, :, 0]
    head_rad = motion.head[motion.valid, 1]
    return RealClipResult(
        clip=clip.id,
        fps=rates[clip.id.rpartition("-")[0]],
        seconds=clip.seconds,
        reject_reason=fit.reject_reason,
        residual_px=float(np.nanmedian(fit.pose.residual_px)),
        head_yaw=float(np.degrees(np.median(head_rad))),
        gaze_range=float(np.degrees(np.ptp(np.percentile(eyes_rad.mean(axis=1), [5, 95])))),
        eye_correlation=correlation(eyes_rad[:, 0], eyes_rad[:, 1]),
        eye_head_correlation=correlation(eyes_rad.mean(axis=1), head_rad),
        blinks=len(fit.lids.blinks),
    )


def table(rows: Sequence[RealClipResult]) -> str:
    """The rows and expected properties, as text for a terminal."""
    head = f"{'clip':<34}{'fps':>7}{'s':>7}{'px':>6}{'head':>7}{'gaze':>7}{'l~r':>7}{'e~h':>7}{'blinks':>8}"
    lines = [head, *(_line(row) for row in rows), ""]
    kept = [row for row in rows if not row.reject_reason]
    moving = [row for row in kept if row.gaze_range > MIN_GAZE_RANGE_DEG]
    facing = [row for row in kept if abs(row.head_yaw) < MAX_FRONTAL_YAW_DEG]
    minutes = sum(row.seconds for row in kept) / 60
    rate = sum(row.blinks for row in kept) / minutes if minutes else 0.0
    together = sum(row.eye_correlation >= MIN_EYE_CORRELATION for row in moving)
    against = sum(row.eye_head_correlation < 0 for row in facing)
    low, high = BLINKS_PER_MINUTE
    return "\n".join(
        [
            *lines,
            f"fitted: {len(kept)} of {len(rows)} clips",
            f"left and right yaw correlate at {MIN_EYE_CORRELATION} or more where gaze moves"
            f" (> {MIN_GAZE_RANGE_DEG:g} degrees): {together} of {len(moving)}",
            f"eyes turn against the head where it faces the camera (< {MAX_FRONTAL_YAW_DEG:g} degrees): "
            f"{against} of {len(facing)}",
            f"blinks per minute, pooled over {minutes:.1f} min: {rate:.1f} "
            f"({'within' if low <= rate <= high else 'outside'} {low:g} to {high:g})",
            f"rejected because the face does not fit: {sum('does not fit' in row.reject_reason for row in rows)}",
        ]
    )


def _line(row: RealClipResult) -> str:
    figures = f"{row.residual_px:6.2f}{row.head_yaw:7.1f}{row.gaze_range:7.1f}{row.eye_correlation:7.2f}"
    line = f"{row.clip:<34}{row.fps:7.2f}{row.seconds:7.2f}{figures}{row.eye_head_correlation:7.2f}{row.blinks:8d}"
    return f"{line}  rejected: {row.reject_reason}" if row.reject_reason else line


def correlation(one: Float[ndarray, " T"], other: Float[ndarray, " T"]) -> float:
    """Correlation of two courses; 0 where one stands still."""
    if len(one) < 3 or one.std() < 1e-9 or other.std() < 1e-9:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def main() -> None:
    """Entry point of the command."""
    if len(sys.argv) != 2:
        raise InputError(f"real: should get a folder of videos, got {' '.join(sys.argv[1:]) or 'nothing'}")
    videos = Path(sys.argv[1])
    if not videos.is_dir():
        print(f"real: no videos at {videos}; nothing to do")
        return
    evaluate_real_videos(videos, jobs=1)


if __name__ == "__main__":
    run_command(main)
