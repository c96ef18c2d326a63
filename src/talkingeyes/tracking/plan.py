"""How long tracking would take and how much it would write: what `talkingeyes track --plan` says, before any of it.

Hours come from what the containers say; the speed is measured on the first seconds of one of the videos, on one core.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from talkingeyes.core.errors import InputError
from talkingeyes.tracking.face_mesh import FaceMesh
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.tracking.shots import shots
from talkingeyes.tracking.sources import Source
from talkingeyes.tracking.video import Facts, facts, frames

TRIAL_FRAMES = 75
# Bytes a second of clip, measured on the real clips of docs/real.md: observations, 16 kHz FLAC, ledger and thumbnail.
BYTES_A_SECOND = {"observations": 9_000, "speech": 20_000, "annotation, ledger and thumbnails": 1_500}


@dataclass(frozen=True)
class Plan:
    """Of all videos that can be opened; `frames_a_second` is what one core tracked."""

    videos: int
    unreadable: tuple[str, ...]
    seconds: float
    frames: float
    frames_a_second: float

    def text(self, jobs: int) -> str:
        """For a person; the most that it can be, since rejected shots write nothing."""
        core_h = self.frames / self.frames_a_second / 3600
        megabytes = self.seconds * sum(BYTES_A_SECOND.values()) / 1e6
        lines = [
            f"{self.videos} videos, {self.seconds / 3600:.2f} h, {self.frames:.0f} frames to track",
            f"{self.frames_a_second:.0f} frames a second on one core: {core_h:.2f} core hours, "
            f"{core_h / jobs:.2f} h with {jobs} jobs",
            f"at most {megabytes:.0f} MB on the disk if every shot is kept",
        ]
        return "\n".join([*lines, *(f"cannot be opened: {name}" for name in self.unreadable)])


def plan(found: Sequence[Source], settings: TrackSettings) -> Plan:
    """Open all containers and try the first video that can be read. Raises InputError if there is none."""
    known: list[tuple[Source, Facts]] = []
    unreadable = []
    for source in found:
        try:
            known.append((source, facts(source.path)))
        except InputError:
            unreadable.append(source.name)
    if not known:
        raise InputError(f"videos: should hold one that can be opened, got none of {len(found)}")
    total = sum(each.seconds * min(each.fps, settings.fastest_fps) for _, each in known)
    speed = _frames_a_second(known[0][0], settings)
    return Plan(len(found), tuple(unreadable), sum(each.seconds for _, each in known), total, speed)


def _frames_a_second(source: Source, settings: TrackSettings) -> float:
    mesh = FaceMesh(settings.face)
    trial = [frame for frame, _ in zip(frames(source.path, settings.fastest_fps), range(TRIAL_FRAMES), strict=False)]
    list(shots(trial[:5], mesh, settings.shot))  # the networks' first frames take longer
    mesh.forget()
    start = time.process_time()
    decoded = zip(frames(source.path, settings.fastest_fps), range(TRIAL_FRAMES), strict=False)
    list(shots((frame for frame, _ in decoded), mesh, settings.shot))
    mesh.close()
    return len(trial) / max(time.process_time() - start, 1e-6)
