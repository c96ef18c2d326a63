"""`talkingeyes render`, `head` and `avatar`: a motion as a video, a head as a picture, the open head as Gaussians."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.cli.head_options import Eyelid, Look


def render(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="A motion (.npz), as `animate` writes it.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The video to write (.mp4).")],
    head: Annotated[str, typer.Option(help="anny (the open head), flame or gaussians.")] = "anny",
    model: Annotated[
        Path | None,
        typer.Option(help="Your FLAME file, for --head flame; the folder of an avatar, for --head gaussians."),
    ] = None,
    eyelid: Eyelid = None,
    look: Look = None,
    camera: Annotated[
        str,
        typer.Option(help="head, face, eyes, left or right; or yaw=, pitch= (degrees), distance=, height= (metres)."),
    ] = "head",
    sound: Annotated[Path | None, typer.Option(help="The speech, as sound track.")] = None,
    size: Annotated[int, typer.Option(help="Pixels, 16 to 4096.")] = 512,
    eyes: Annotated[
        str, typer.Option(help="What the pupils show: visual (the lines of sight) or optical (the optical axes).")
    ] = "visual",
    keys: Annotated[Path | None, typer.Option(help="Edited saccades and blinks: an .events.json of `animate`.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Render a motion on a head as a video, with sound, at the motion's own frame rate."""
    from talkingeyes.workflows.render import render as make

    done = make(
        motion,
        out,
        head=head,
        model=model,
        eyelid=eyelid,
        look=look,
        camera=camera,
        sound=sound,
        size=size,
        eyes=eyes,
        keys=keys,
        force=force,
    )
    typer.echo(f"{out}: {done.seconds:.2f} s at {done.fps:g} fps")
    if done.parts_at_rest:
        typer.echo(f"{out}: note: at rest in the motion: {', '.join(done.parts_at_rest)}", err=True)


def render_head(
    out: Annotated[Path, typer.Option("-o", "--out", help="The picture to write (.png).")],
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your FLAME file, for --head flame.")] = None,
    eyelid: Eyelid = None,
    look: Look = None,
    size: Annotated[int, typer.Option(help="Width in pixels.")] = 1400,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Render a sheet of a head: gaze in nine directions, lids at five openings."""
    from talkingeyes.workflows.render import render_head_sheet

    render_head_sheet(out, head=head, model=model, eyelid=eyelid, look=look, size=size, force=force)
    typer.echo(f"{out}: gaze in nine directions, lids at five openings")


def make_avatar(
    out: Annotated[Path, typer.Option("-o", "--out", help="The folder to write, for --head gaussians --model DIR.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier avatar.")] = False,
) -> None:
    """Make a Gaussian avatar of the open head, in the layout of GaussianAvatars."""
    from talkingeyes.workflows.render import make_avatar as make

    typer.echo(f"{out}: {make(out, force=force):,} Gaussians on the open head")
