"""`talkingeyes animate`: speech in, motion out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def animate(
    speech: Annotated[
        Path, typer.Argument(metavar="SPEECH", help="A sound file: wav, flac, ogg, mp3, m4a; 0.3 s to an hour.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The folder to write: new, or empty.")],
    samples: Annotated[int, typer.Option(help="How many motions to draw for the speech.")] = 3,
    seed: Annotated[int, typer.Option(help="The same seed gives the same motions.")] = 0,
    fps: Annotated[float, typer.Option(help="Frames a second, 10 to 240.")] = 25.0,
    blinks: Annotated[str, typer.Option(help="Rate of blinks: physio, paper or corpus.")] = "physio",
    model: Annotated[Path, typer.Option(help="A trained model; `make repro` makes this one.")] = Path(
        "data/train/talkingeyes"
    ),
    formats: Annotated[
        list[str] | None, typer.Option("-f", "--format", help="Another format for each motion, as `export` has them.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the output of an earlier call.")] = False,
) -> None:
    """Draw motions for speech: npz, events, a small video with sound for each, and a plot of all."""
    from talkingeyes.animation import animate as make

    motions = make(
        speech, out, samples=samples, seed=seed, fps=fps, blinks=blinks, model=model, formats=formats or (), force=force
    )
    count = "1 motion" if samples == 1 else f"{samples} motions"
    typer.echo(f"{out}: {count} of {motions[0].seconds:.2f} s at {fps:g} frames a second")
