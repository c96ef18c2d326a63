"""Stage `track`: a corpus from videos, as `talkingeyes track` makes it. Outside the default pipeline: it needs videos.

Reads   a folder of videos (or one video)
Writes  data/track/: a corpus without truth (docs/conventions.md), tracked.csv, rejected.csv, failed.csv, summary.json,
        thumbnails.html (docs/data.md)
Run     python -m pipelines.track VIDEOS && make repro corpus=data/track
"""

from __future__ import annotations

from pathlib import Path

from talkingeyes.orchestration.run import CHECKSUMS_FILE, Report, Workspace, checksums, main
from talkingeyes.tracking.report import yield_summary
from talkingeyes.tracking.settings import TrackSettings
from talkingeyes.workflows.track import track


def run(workspace: Workspace, videos: str) -> Report:
    """Track all videos; resumes an interrupted run."""
    settings = workspace.settings("track", TrackSettings)
    folder = workspace.data("track")
    tracked = track([Path(videos)], folder, settings, jobs=workspace.jobs)
    (folder / CHECKSUMS_FILE).unlink(missing_ok=True)
    (folder / CHECKSUMS_FILE).write_text(checksums(folder))
    total = yield_summary(tracked.outcomes)
    return Report(metrics={name: float(value) for name, value in total.items() if name != "rejected"})


if __name__ == "__main__":
    main(run)
