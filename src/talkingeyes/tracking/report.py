"""Report of tracking: tracked.csv, rejected.csv, failed.csv, summary.json, and a page of thumbnails.

A shot is identified by its video (its name in the corpus) and its times, so that it can be checked.
"""

from __future__ import annotations

import csv
import html
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from talkingeyes.tracking.journal import ShotRecord
from talkingeyes.tracking.sources import VideoSource

NO_FACE = "no face was found"
DUPLICATE_OF = "a copy of"


@dataclass(frozen=True)
class VideoResult:
    """One video: its shots, with reasons from the comparison of all videos; or the error that prevented reading it."""

    source: VideoSource
    entries: tuple[ShotRecord, ...]
    seconds: float
    failure: str


def write_tables(folder: Path, outcomes: Sequence[VideoResult]) -> None:
    """tracked.csv: kept shots and their crops; rejected.csv: reasons; failed.csv: videos with errors."""
    shots = [(outcome.source, entry) for outcome in outcomes for entry in outcome.entries]
    columns = ("clip", "video", "start_s", "stop_s", "crop_x", "crop_y", "crop_zoom")
    kept = [(source, entry) for source, entry in shots if not entry.reason]
    _write_csv(folder / "tracked.csv", columns, (_where(source, entry) for source, entry in kept))
    rejected = [
        (entry.id, source.name, f"{entry.start_s:.3f}", f"{entry.stop_s:.3f}", entry.reason)
        for source, entry in shots
        if entry.reason
    ]
    rejected += [("", o.source.name, "0.000", f"{o.seconds:.3f}", NO_FACE) for o in outcomes if _faceless(o)]
    _write_csv(folder / "rejected.csv", ("clip", "video", "start_s", "stop_s", "reason"), sorted(rejected, key=str))
    failure = [(outcome.source.name, outcome.failure) for outcome in outcomes if outcome.failure]
    _write_csv(folder / "failed.csv", ("video", "error"), failure)


def yield_summary(outcomes: Sequence[VideoResult]) -> dict[str, Any]:
    """The yield: videos, shots and seconds, and rejections by reason (without its numbers)."""
    entries = [entry for outcome in outcomes for entry in outcome.entries]
    kept = [entry for entry in entries if not entry.reason]
    reasons: dict[str, list[float]] = {}
    for entry in entries:
        if entry.reason:
            reasons.setdefault(_kind(entry.reason), []).append(entry.quality.seconds)
    for outcome in outcomes:
        if _faceless(outcome):
            reasons.setdefault(NO_FACE, []).append(outcome.seconds)
    video_s = sum(outcome.seconds for outcome in outcomes)
    kept_s = sum(entry.quality.seconds for entry in kept)
    return {
        "videos": len(outcomes),
        "videos_failed": sum(bool(outcome.failure) for outcome in outcomes),
        "video_s": round(video_s, 3),
        "shots": len(entries),
        "clips": len(kept),
        "clips_s": round(kept_s, 3),
        "yield": round(kept_s / video_s, 4) if video_s else 0.0,
        "rejected": {reason: {"shots": len(s), "seconds": round(sum(s), 3)} for reason, s in sorted(reasons.items())},
    }


def write_page(path: Path, thumbnail: dict[str, str], outcomes: Sequence[VideoResult]) -> None:
    """A page of all shots, kept ones first; `thumbnail`: the file of each, relative to the page."""
    shots = [(outcome.source, entry) for outcome in outcomes for entry in outcome.entries if entry.id in thumbnail]
    parts = [
        f"<h2>{title}: {len(group)}</h2>\n" + "\n".join(_figure(source, entry, thumbnail) for source, entry in group)
        for title, group in (
            ("Kept", [shot for shot in shots if not shot[1].reason]),
            ("Rejected", [shot for shot in shots if shot[1].reason]),
        )
    ]
    style = "body{font:14px sans-serif} figure{display:inline-block;width:150px;margin:6px;vertical-align:top}"
    head = f"<!doctype html><meta charset=utf-8><title>Tracked shots</title><style>{style}</style>"
    path.write_text(f"{head}\n<h1>Tracked shots</h1>\n" + "\n".join(parts) + "\n")


def write_summary(path: Path, outcomes: Sequence[VideoResult]) -> None:
    """Write summary.json."""
    path.write_text(json.dumps(yield_summary(outcomes), indent=1) + "\n")


def as_text(outcomes: Sequence[VideoResult]) -> str:
    """Readable yield, one line per reason."""
    total = yield_summary(outcomes)
    lines = [
        f"{total['videos']} videos, {total['video_s'] / 60:.1f} min; {total['clips']} clips kept, "
        f"{total['clips_s'] / 60:.1f} min ({total['yield']:.0%})"
    ]
    lines += [f"  rejected, {reason}: {of['shots']}" for reason, of in total["rejected"].items()]
    lines += [f"  failed, {o.source.name}: {o.failure}" for o in outcomes if o.failure]
    return "\n".join(lines)


def _faceless(outcome: VideoResult) -> bool:
    return not outcome.entries and not outcome.failure


def _kind(reason: str) -> str:
    return DUPLICATE_OF + " another" if reason.startswith(DUPLICATE_OF) else reason.partition(":")[0]


def _where(source: VideoSource, entry: ShotRecord) -> Sequence[Any]:
    crop = [f"{value:.6g}" for value in asdict(entry.crop).values()]
    return (entry.id, source.name, f"{entry.start_s:.6f}", f"{entry.stop_s:.6f}", *crop)


def _figure(source: VideoSource, entry: ShotRecord, thumbnail: dict[str, str]) -> str:
    about = f"{html.escape(source.name)} {entry.start_s:.1f}&ndash;{entry.stop_s:.1f} s"
    image = f'<img loading=lazy src="{html.escape(thumbnail[entry.id])}" alt="">'
    return f"<figure>{image}<figcaption>{about}<br>{html.escape(entry.reason)}</figcaption></figure>"


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)
