"""`talkingeyes view`: motions in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Host = Annotated[str, typer.Option(help="The address to listen at; anything but 127.0.0.1 lets others in.")]
Port = Annotated[int, typer.Option(help="The port; 0 takes a free one.")]


def view(
    motions: Annotated[
        list[Path], typer.Argument(metavar="MOTION...", help="Motions (.npz), or files of the stage `sample`.")
    ],
    truth: Annotated[Path | None, typer.Option(help="The true motion, to stand beside them.")] = None,
    sound: Annotated[Path | None, typer.Option(help="The speech; else that of MOTION.mp4 beside the first.")] = None,
    words: Annotated[Path | None, typer.Option(help="An annotation (.json) with the words that are said.")] = None,
    corpus: Annotated[
        Path | None, typer.Option(help="A corpus with a clip named as the first motion: its sound, words and truth.")
    ] = None,
    head: Annotated[str, typer.Option(help="anny (the open head) or flame.")] = "anny",
    model: Annotated[Path | None, typer.Option(help="Your own FLAME file, for --head flame.")] = None,
    host: Host = "127.0.0.1",
    port: Port = 8010,
) -> None:
    """Show motions side by side in the browser, in step, with sound, traces, gaze rays and words."""
    from talkingeyes.viewing import view as show

    show(
        motions,
        truth=truth,
        sound=sound,
        words=words,
        corpus=corpus,
        head=head,
        model=model,
        host=host,
        port=port,
        started=lambda address: typer.echo(f"{address} shows the motions; end with Ctrl-C"),
    )
