"""The command line: `talkingeyes animate SPEECH -o DIR`. A mistake is one line on stderr and exit status 2."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from talkingeyes.run import shell

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Speech in; eye gaze, head motion and blinks out.",
)


@app.callback()
def _talkingeyes() -> None:
    """Keeps `animate` a word of its own, beside the commands to come."""


@app.command()
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
    force: Annotated[bool, typer.Option("--force", help="Replace the output of an earlier call.")] = False,
) -> None:
    """Draw motions for speech: npz, events, a small video with sound for each, and a plot of all."""
    from talkingeyes.animation import animate as make

    motions = make(speech, out, samples=samples, seed=seed, fps=fps, blinks=blinks, model=model, force=force)
    count = "1 motion" if samples == 1 else f"{samples} motions"
    typer.echo(f"{out}: {count} of {motions[0].seconds:.2f} s at {fps:g} frames a second")


def main() -> None:
    """The entry point of the console script."""
    shell(app)


if __name__ == "__main__":
    main()
