"""Estimate of duration and disk space of tracking, printed by `talkingeyes track --dry-run`.

Durations come from the container headers; throughput is measured on the first seconds of one video, on one core.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from talkingeyes.core.errors import InputError
from talkingeyes.tracking.face_mesh import FaceMesh
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.shots import detect_shots
from talkingeyes.tracking.sources import VideoSource
from talkingeyes.tracking.video import VideoInfo, probe_video, read_frames

TRIAL_FRAMES = 75
# Bytes per second of clip, measured on the clips of docs/results/real_videos.md: observations, 16 kHz FLAC, journal,
# thumbnail.
BYTES_PER_SECOND = {"observations": 9_000, "speech": 20_000, "annotation, ledger and thumbnails": 1_500}


@dataclass(frozen=True)
class TrackingEstimate:
    """Totals over the readable videos; `throughput_fps` is the measured speed of one core."""

    videos: int
    unreadable: tuple[str, ...]
    seconds: float
    frames: float
    throughput_fps: float

    def text(self, jobs: int) -> str:
        """Readable summary; sizes are upper limits, because rejected shots write nothing."""
        core_h = self.frames / self.throughput_fps / 3600
        megabytes = self.seconds * sum(BYTES_PER_SECOND.values()) / 1e6
        lines = [
            f"{self.videos} videos, {self.seconds / 3600:.2f} h, {self.frames:.0f} frames to track",
            f"{self.throughput_fps:.0f} frames a second on one core: {core_h:.2f} core hours, "
            f"{core_h / jobs:.2f} h with {jobs} jobs",
            f"at most {megabytes:.0f} MB on the disk if every shot is kept",
        ]
        return "\n".join([*lines, *(f"cannot be opened: {name}" for name in self.unreadable)])


def estimate_tracking(found: Sequence[VideoSource], settings: TrackSettings) -> TrackingEstimate:
    """Read all containers and measure the first readable video. Raises InputError if there is none."""
    known: list[tuple[VideoSource, VideoInfo]] = []
    unreadable = []
    for source in found:
        try:
            known.append((source, probe_video(source.path)))
        except InputError:
            unreadable.append(source.name)
    if not known:
        raise InputError(f"videos: should contain one that can be opened, got none of {len(found)}")
    total = sum(each.seconds * min(each.fps, settings.max_fps) for _, each in known)
    speed = _measure_throughput(known[0][0], settings)
    return TrackingEstimate(len(found), tuple(unreadable), sum(each.seconds for _, each in known), total, speed)


def _measure_throughput(source: VideoSource, settings: TrackSettings) -> float:
    mesh = FaceMesh(settings.face)
    trial = [frame for frame, _ in zip(read_frames(source.path, settings.max_fps), range(TRIAL_FRAMES), strict=False)]
    list(detect_shots(trial[:5], mesh, settings.shot))  # the first inferences of the networks take longer
    mesh.reset()
    start = time.process_time()
    decoded = zip(read_frames(source.path, settings.max_fps), range(TRIAL_FRAMES), strict=False)
    list(detect_shots((frame for frame, _ in decoded), mesh, settings.shot))
    mesh.close()
    return len(trial) / max(time.process_time() - start, 1e-6)
