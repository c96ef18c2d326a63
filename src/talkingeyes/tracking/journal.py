"""Progress of tracking one video: one line per shot, written with its clip, so a crash loses one shot at most.

JSON lines. During tracking, each attempt adds `begin`; at the end the file is rewritten without these lines, so an
interrupted and resumed run produces the same bytes as an uninterrupted one.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from talkingeyes.tracking.clip_filter import ShotQuality
from talkingeyes.tracking.cropping import Crop


@dataclass(frozen=True)
class ShotRecord:
    """A shot, kept if `reason` is empty. Tracking resumes at `resume_s` after it, null at the end of the video."""

    id: str
    start_s: float
    stop_s: float
    resume_s: float | None
    end_reason: str
    reason: str
    crop: Crop
    fingerprint: str
    content_hash: str
    quality: ShotQuality


@dataclass(frozen=True)
class TrackingJournal:
    """Progress of one video: shots, attempts since the last shot, and outcome; `seconds`: time of the last frame."""

    entries: tuple[ShotRecord, ...] = ()
    attempt_count: int = 0
    done: bool = False
    failure: str = ""
    seconds: float = 0.0

    @property
    def resume_s(self) -> float:
        """Time at which tracking resumes."""
        following = self.entries[-1].resume_s if self.entries else None
        return -1e9 if following is None else following


def read(path: Path) -> TrackingJournal:
    """Read a journal; an empty one if there is no file.

    A truncated last line is ignored. The last shot of an unfinished video is dropped if it ended with the video,
    because only another pass determines the video's end.
    """
    video_journal = _read(path)
    unsure = not video_journal.done and video_journal.entries and video_journal.entries[-1].resume_s is None
    return replace(video_journal, entries=video_journal.entries[:-1]) if unsure else video_journal


def _read(path: Path) -> TrackingJournal:
    if not path.exists():
        return TrackingJournal()
    entries: dict[str, ShotRecord] = {}
    attempt_count, failure, done, seconds = 0, "", False, 0.0
    for line in path.read_text().splitlines():
        try:
            kind, content = next(iter(json.loads(line).items()))
        except ValueError:
            break
        if kind == "shot":
            entries[content["id"]] = _entry(content)
            attempt_count = 0
        attempt_count = 0 if kind == "failed" else attempt_count + (kind == "begin")
        failure = content if kind == "failed" else ""
        done, seconds = (True, content) if kind == "end" else (False, seconds)
    return TrackingJournal(tuple(entries.values()), attempt_count, done, failure, seconds)


def add(path: Path, kind: str, content: Any) -> None:
    """Append a line: begin, shot, failed."""
    if path.exists() and not path.read_bytes().endswith(b"\n"):  # truncated by a crash
        path.write_text("".join(line + "\n" for line in path.read_text().splitlines()[:-1]))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps({kind: asdict(content) if isinstance(content, ShotRecord) else content}) + "\n")


def finish(path: Path, seconds: float) -> None:
    """Rewrite the journal of a finished video: its shots and its end."""
    lines = [json.dumps({"shot": asdict(entry)}) for entry in _read(path).entries]
    partial = path.with_suffix(".partial")
    partial.write_text("".join(line + "\n" for line in [*lines, json.dumps({"end": seconds})]))
    partial.replace(path)


def _entry(content: dict[str, Any]) -> ShotRecord:
    parts = {"crop": Crop(**content["crop"]), "quality": ShotQuality(**content["quality"])}
    return ShotRecord(**{**content, **parts})
