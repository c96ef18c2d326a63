"""`talkingeyes track`: videos become a corpus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO_OR_FOLDER...", help="Videos, or folders of them.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The corpus to write, or to go on with.")],
    speakers: Annotated[Path | None, typer.Option(help="Who speaks: a CSV with the columns video, speaker.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; a video each.")] = 1,
    plan: Annotated[bool, typer.Option("--plan", help="Only say how long it takes and what it writes.")] = False,
    silent: Annotated[bool, typer.Option("--silent", help="Keep clips without a voice too.")] = False,
    thumbnails: Annotated[bool, typer.Option(help="Small pictures of the faces, and a page of them.")] = True,
    overlay: Annotated[bool, typer.Option("--overlay", help="Film the fitted head beside each clip.")] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="A value of conf/track, such as clip_filter.min_duration_s=2.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Begin anew; forget what was tracked before.")] = False,
) -> None:
    """Make a corpus of videos: landmarks, pupils and speech of every clip with one visible, speaking face."""
    from talkingeyes.workflows.track import track_command

    overrides = ["fit=video", *(f"track.{each}" for each in setting or [])]
    overrides += ["track.clip_filter.require_voice=false"] * silent + ["track.thumbnails=false"] * (not thumbnails)
    for line in track_command(
        videos, out, overrides, speakers=speakers, jobs=jobs, dry_run=plan, overlay=overlay, force=force
    ):
        typer.echo(line)
