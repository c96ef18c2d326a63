"""`talkingeyes track`: from videos to a corpus; `talkingeyes capture`: gaze and lids by the Eyelid model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.cli.head_options import Eyelid


def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO_OR_FOLDER...", help="Videos, or folders of them.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The corpus to write, or to resume.")],
    speakers: Annotated[Path | None, typer.Option(help="Speakers: a CSV with the columns video, speaker.")] = None,
    jobs: Annotated[int, typer.Option(help="Number of processes; one video each.")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only estimate time and disk space.")] = False,
    keep_silent: Annotated[bool, typer.Option("--keep-silent", help="Keep clips without speech too.")] = False,
    thumbnails: Annotated[bool, typer.Option(help="Write thumbnails of the faces and a page of them.")] = True,
    overlay: Annotated[bool, typer.Option("--overlay", help="Render the fitted head beside each clip.")] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="Set a value of conf/track, such as clip_filter.min_duration_s=2.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Start again and discard earlier results.")] = False,
) -> None:
    """Make a corpus from videos: landmarks, pupils and speech of every clip with one visible, speaking face."""
    from talkingeyes.workflows.track import track_command

    overrides = ["fit=video", *(f"track.{each}" for each in setting or [])]
    overrides += ["track.clip_filter.require_voice=false"] * keep_silent + ["track.thumbnails=false"] * (not thumbnails)
    for line in track_command(
        videos, out, overrides, speakers=speakers, jobs=jobs, dry_run=dry_run, overlay=overlay, force=force
    ):
        typer.echo(line)


def capture(
    views: Annotated[
        list[Path],
        typer.Argument(metavar="VIEW...", help="A video, an image, or a folder of images; up to three views."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The folder to write.")],
    cameras: Annotated[Path | None, typer.Option(help="Calibrated cameras of the views (.json).")] = None,
    eyelid: Eyelid = None,
    fps: Annotated[float, typer.Option(help="Frames per second of images.")] = 25.0,
    overlay: Annotated[bool, typer.Option("--overlay", help="Film the first view with the curves found.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Capture gaze and lids of a face, and whether they can be trusted (docs/eyelid.md)."""
    from talkingeyes.workflows.capture import capture_command

    for line in capture_command(views, out, cameras=cameras, eyelid=eyelid, fps=fps, overlay=overlay, force=force):
        typer.echo(line)
